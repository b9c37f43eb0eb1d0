"""``python -m rigctl.recorder RUNTIME_DIR``."""

import signal
import sys
import threading

stop = threading.Event()
signal.signal(signal.SIGTERM, lambda _number, _frame: stop.set())  # before the imports: a daemon may end within them

from rigctl.recorder.process import main  # noqa: E402

raise SystemExit(main(sys.argv[1:], stop))
