"""A command whose ``/dev/shm`` is a small memory disk of its own, as in a container."""

from __future__ import annotations

import functools
import os
import subprocess

import pytest

_OWN = ["unshare", "--mount", *(["--map-root-user"] if os.geteuid() else []), "sh", "-c"]


def with_small_memory(size: str, *command: str) -> list[str]:
    """``command`` with a ``/dev/shm`` of ``size``, as mount(8) writes it; skips the test where no mount is allowed."""
    if why := _refusal():
        pytest.skip(f"this computer allows no mount of its own: {why}")
    return [*_OWN, f'mount -t tmpfs -o mode=1777,size={size} tmpfs /dev/shm && exec "$@"', "sh", *command]


@functools.cache
def _refusal() -> str:
    try:
        tried = subprocess.run([*_OWN, "mount -t tmpfs tmpfs /dev/shm"], capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        return str(error)
    return tried.stderr.strip() if tried.returncode else ""
