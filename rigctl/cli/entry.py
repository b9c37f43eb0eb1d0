"""Entry point of ``rigctl``: one line instead of a traceback where an extra is missing."""

from __future__ import annotations

import os

from rigctl.config import extras


def main() -> None:
    """Run one command and exit, see `rigctl.cli.app.main`."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: more threads are slower with matrices this small
    with extras.refused("rigctl"):
        from rigctl.cli.app import main as run

        run()
