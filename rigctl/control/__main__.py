"""``python -m rigctl.control RUNTIME_DIR``: started by the supervisor."""

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads would share the loop's core

if __name__ == "__main__":
    from rigctl.ipc import standard_output

    standard_output.never_wait()
    from rigctl.control.control_process import run

    sys.exit(run(sys.argv[1]))
