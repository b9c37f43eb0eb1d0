"""The daemon that holds a suspended antenna mechanism weightless."""

import sys

__version__ = "0.1.0"

# python-can imports asammdf, and pandas with it, wherever it is installed. `rigctl.recorder.mdf4` lifts this.
sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]
