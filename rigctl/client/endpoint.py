"""The endpoint that a client connects to."""

from __future__ import annotations

import os

from rigctl.wire.keys import DEFAULT_ENDPOINT


def chosen_endpoint(connect: str | None) -> str:
    """The endpoint given, else ``RIGCTL_CONNECT``, else the default."""
    return connect or os.environ.get("RIGCTL_CONNECT") or DEFAULT_ENDPOINT
