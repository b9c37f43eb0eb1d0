"""The operator's name, as every command gives it."""

from __future__ import annotations

import os


def operator_name(given: str | None) -> str:
    """The name given, else ``RIGCTL_OPERATOR``, else the login name."""
    if given := given or os.environ.get("RIGCTL_OPERATOR"):
        return given.encode(errors="replace").decode()
    import getpass

    try:
        return getpass.getuser()
    except (KeyError, OSError):  # there is no login name, as in a bare container
        return f"uid {os.getuid()}"
