"""``python -m rigctl.recorder RUNTIME_DIR``."""

import signal
import sys

from rigctl.ipc import standard_output
from rigctl.ipc.termination import Termination

standard_output.never_wait()
stop = Termination(signal.SIGTERM, signal.SIGHUP)  # before the other imports: the daemon may end during them

from rigctl.recorder.recorder_process import main  # noqa: E402

raise SystemExit(main(sys.argv[1:], stop))
