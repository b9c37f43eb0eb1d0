"""The real-time process: one thread owns the bus and the law."""

import sys

# python-can imports asammdf, and pandas with it, wherever it is installed. `rigctl.recorder.mdf4` lifts this.
sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]
