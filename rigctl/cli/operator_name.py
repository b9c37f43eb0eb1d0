"""The name that is added to the user's own, as every command gives it."""

from __future__ import annotations

import os


def operator_name(given: str | None) -> str:
    """The name given, else ``RIGCTL_OPERATOR``; empty for the user's own."""
    return (given or os.environ.get("RIGCTL_OPERATOR", "")).encode(errors="replace").decode()
