"""``python -m rigctl.config.bounds_page RIG.yaml``: the page of ``docs/bounds.md``."""

from __future__ import annotations

import sys

from rigctl.config.bounds import document
from rigctl.config.rig_file import load

if __name__ == "__main__":
    sys.stdout.write(document(load(sys.argv[1])))
