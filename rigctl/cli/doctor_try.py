"""``python -m rigctl.cli.doctor_try``: requests real time as the loop does, prints what was granted, and ends.

The loop's settings come as JSON on standard input; the result goes out as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict

from rigctl.config.settings import LoopSettings
from rigctl.control import realtime


def main() -> int:
    """Try, and return to normal scheduling at once."""
    loop = LoopSettings.model_validate_json(sys.stdin.read())
    applied = realtime.apply(loop)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    sys.stdout.write(json.dumps([asdict(setting) for setting in applied]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
