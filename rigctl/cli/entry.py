"""Entry point of ``rigctl``: one line instead of a traceback where an extra is missing."""

from __future__ import annotations

from rigctl.config import extras


def main() -> None:
    """Run one command and exit, see `rigctl.cli.app.main`."""
    with extras.refused("rigctl"):
        from rigctl.cli.app import main as run

        run()
