"""The plant's true state, and its log: what no device of the rig can see."""

from __future__ import annotations

import pathlib
import struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt


class Truth(NamedTuple):
    """The plant at one moment."""

    t_ns: int
    tension_n: float
    vertical_n: float
    tangential_rad: float
    normal_rad: float
    stroke_mm: float
    speed_mm_s: float
    mechanism_rad: float
    rail_rad: float
    pulley_mm: float
    height_mm: float
    moving: bool


_RECORD = struct.Struct("<q10d?")
_FLUSH_RECORDS = 1000

TRUTH_DTYPE = np.dtype([("t_ns", "<i8"), *((name, "<f8") for name in Truth._fields[1:-1]), ("moving", "?")])
"""One record of a truth log: the fields of ``Truth``, packed, little-endian."""


class TruthLog:
    """Writes one record per call to a file, in blocks of a second (at one record per millisecond)."""

    def __init__(self, path: str | pathlib.Path) -> None:
        self._file = pathlib.Path(path).open("wb", buffering=0)  # noqa: SIM115 - closed by close()
        self._waiting: list[bytes] = []

    def append(self, truth: Truth) -> None:
        """Log one moment."""
        self._waiting.append(_RECORD.pack(*truth))
        if len(self._waiting) >= _FLUSH_RECORDS:
            self.flush()

    def flush(self) -> None:
        """Write the waiting records."""
        self._file.write(b"".join(self._waiting))
        self._waiting.clear()

    def close(self) -> None:
        """Flush and close."""
        self.flush()
        self._file.close()


def read(path: str | pathlib.Path) -> npt.NDArray[Any]:
    """Records of a truth log (dtype ``TRUTH_DTYPE``); a record cut short at the end is left out."""
    data = pathlib.Path(path).read_bytes()
    return np.frombuffer(data, TRUTH_DTYPE, len(data) // TRUTH_DTYPE.itemsize)
