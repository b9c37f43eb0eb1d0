"""The runs that are recorded on this computer, and what is made of one: by commands in processes of their own.

They run at the lowest priority, one at a time: reading a recording must not take the loop's time.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pathlib
import re
import shutil
import sys
import tempfile
from collections.abc import AsyncIterator
from typing import Any

import msgspec

LIMIT_S = 600.0
NAME = re.compile(r"(?:trip-)?[0-9]{1,18}")
MADE = {
    "report": ("report.html", ("report", "{name}", "-o", "{file}")),
    "picture": ("overview.svg", ("report", "{name}", "-o", "{folder}/report.html", "--picture", "{file}")),
    "csv": ("tables.zip", ("export", "{name}", "--to", "csv", "-o", "{folder}/tables")),
}
"""By what is asked for: name of the file, and the command that makes it."""


class RunFilesError(RuntimeError):
    """The command has failed; ``str()`` is its line."""


class RunFiles:
    """Of the rig that the page shows."""

    def __init__(self) -> None:
        self._one = asyncio.Lock()

    async def listed(self, rig: str) -> list[dict[str, Any]]:
        """What ``rigctl runs --json`` lists, the newest first.

        Raises:
            RunFilesError: the recordings are on another computer, or cannot be read.
        """
        async with self._one:
            found: list[dict[str, Any]] = msgspec.json.decode(await _run(rig, "runs", "--json"))
        return [{name: value for name, value in run.items() if name != "files"} for run in reversed(found)]

    @contextlib.asynccontextmanager
    async def made(self, rig: str, name: str, what: str) -> AsyncIterator[pathlib.Path]:
        """A file made of a run, which is there within the context.

        Raises:
            RunFilesError: there is no such run, or the file cannot be made.
        """
        if what not in MADE or not NAME.fullmatch(name):
            raise RunFilesError(f"found {what[:40]!r} of {name[:40]!r}, expected {', '.join(MADE)} of a run")
        called, command = MADE[what]
        async with self._one:
            folder = pathlib.Path(tempfile.mkdtemp(prefix="rigctl-run-"))
            try:
                file = folder / called
                await _run(rig, *(word.format(name=name, file=file, folder=folder) for word in command), bad=file)
                if what == "csv":
                    await asyncio.to_thread(shutil.make_archive, str(file.with_suffix("")), "zip", folder / "tables")
                yield file
            finally:
                await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)


async def _run(rig: str, *words: str, bad: pathlib.Path | None = None) -> bytes:
    """Standard output of a command; one that has made ``bad`` has done its work, whatever its verdict."""
    process = await asyncio.create_subprocess_exec(
        "nice", "-n", "19", sys.executable, "-m", "rigctl", *words,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env={**os.environ, "RIGCTL_RIG": rig},
    )  # fmt: skip
    try:
        out, err = await asyncio.wait_for(process.communicate(), LIMIT_S)
    except TimeoutError:
        process.kill()
        await process.wait()
        raise RunFilesError(f"rigctl {words[0]} has not ended within {LIMIT_S:g} s") from None
    if process.returncode and not (bad is not None and bad.exists()):
        raise RunFilesError(" ".join(err.decode(errors="replace").split())[:400] or f"rigctl {words[0]} has failed")
    return out
