"""Extras of the package: what a computer needs beyond the control process, and the refusal where one is missing."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

EXTRAS = {
    "client": {"zenoh"},
    "rt": {
        "cryptography", "yaml", "cantools", "scipy", "control", "filterpy", "matplotlib", "mcap", "google", "typer",
        "rich", "starlette", "uvicorn", "websockets", "h11",
    },
    "ops": {"jinja2", "pyarrow"},
    "sim": {"numba"},
    "studies": {"simple_pid", "cvxpy", "clarabel", "cma"},
    "bridge": {"prometheus_client"},
    "mdf": {"asammdf"},
    "test": {"pytest", "pandas"},
}  # fmt: skip
"""Top-level modules that each extra of pyproject.toml brings; the control process needs none of them."""


def extra_of(module: str) -> str | None:
    """The extra that brings a module, None for a module of no extra."""
    return next((extra for extra, modules in EXTRAS.items() if module.partition(".")[0] in modules), None)


@contextlib.contextmanager
def refused(program: str) -> Iterator[None]:
    """A block of which a missing extra, or Ctrl-C while modules are loaded, ends the program with one line."""
    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write(f"{program}: interrupted\n")
        raise SystemExit(1) from None
    except ModuleNotFoundError as error:
        extra = extra_of(error.name or "")
        if extra is None:
            raise
        module = (error.name or "").partition(".")[0]
        sys.stderr.write(f"{program}: needs the extra {extra}: found no {module} (pip install 'rigctl[{extra}]')\n")
        raise SystemExit(2) from None
