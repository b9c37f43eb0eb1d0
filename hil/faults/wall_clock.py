"""A wall clock that can be stepped: loaded into the daemon's processes before any other module, through PYTHONPATH.

The machine's own clock is shared and stays as it is; CLOCK_MONOTONIC cannot be stepped at all. `time.time` and
`time.time_ns` of these processes follow a file of one signed 64 bit number, the step in ns.
"""

from __future__ import annotations

import mmap
import os
import pathlib
import struct
import time

FILE_VARIABLE = "HIL_FAULTS_WALL_CLOCK"
_STEP = struct.Struct("<q")
_START = "import hil.faults.wall_clock as clock\n\nclock.follow_file_of_environment()\n"
START_FILE = "sitecustomize.py"


def prepare(folder: pathlib.Path) -> dict[str, str]:
    """Make the file in ``folder``; returns the environment of the processes that follow it."""
    step(folder, 0)
    (folder / START_FILE).write_text(_START)
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH", ""))))
    return {**os.environ, "PYTHONPATH": path, FILE_VARIABLE: str(_file(folder))}


def step(folder: pathlib.Path, step_ns: int) -> None:
    """Step the wall clock of these processes by ``step_ns`` against the machine's."""
    file = _file(folder)
    if not file.exists():
        file.write_bytes(_STEP.pack(0))
    with file.open("r+b") as stream:
        stream.write(_STEP.pack(step_ns))


def follow_file_of_environment() -> None:
    """Make this process's wall clock the machine's plus the step."""
    with pathlib.Path(os.environ[FILE_VARIABLE]).open("rb") as stream:
        memory = mmap.mmap(stream.fileno(), _STEP.size, prot=mmap.PROT_READ)
    machines, machines_ns, unpack = time.time, time.time_ns, _STEP.unpack_from
    time.time = lambda: machines() + unpack(memory)[0] * 1e-9
    time.time_ns = lambda: machines_ns() + int(unpack(memory)[0])


def _file(folder: pathlib.Path) -> pathlib.Path:
    return folder / "wall_clock_step"
