"""``python -m rigctl.hold RUNTIME_DIR``."""

import signal
import sys

from rigctl.ipc.termination import Termination

stop = Termination(signal.SIGTERM, signal.SIGHUP)  # before the other imports: the daemon may end during them

from rigctl.hold.service import main  # noqa: E402

raise SystemExit(main(sys.argv[1:], stop))
