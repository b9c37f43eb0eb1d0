"""A recording as ASAM MDF 4.10, which CANape, INCA and asammdf's own viewer open.

One channel group for each topic, with seconds after the first record as its master channel. Enumerations are numbers
with a value-to-text conversion, so that tools show names and scripts keep numbers.
"""

from __future__ import annotations

import datetime
import importlib
import pathlib
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from rigctl.recorder.columns import Column
from rigctl.recorder.recording import Recording

TIME, MASTER_UNIT = "t_s", "s"
COMPRESSED = 1  # asammdf: deflate
_DISTRIBUTION = "asammdf"


def write(recording: Recording, tables: Mapping[str, list[Column]], file: pathlib.Path) -> None:
    """Write the tables of a recording.

    Raises:
        ModuleNotFoundError: the extra mdf is not installed.
    """
    asammdf = _library()
    with asammdf.MDF(version="4.10") as mdf:
        mdf.start_time = datetime.datetime.fromtimestamp(
            (recording.start_ns + recording.wall_offset_ns) * 1e-9, datetime.UTC
        )
        for topic, columns in tables.items():
            by_name = {column.name: column for column in columns}
            t_s = np.asarray(by_name.pop(TIME).values, np.float64)
            signals = [_signal(asammdf, topic, column, t_s) for column in by_name.values()]
            mdf.append(signals, acq_name=topic, comment=f"{recording.rig} {recording.run}: {topic}")
        mdf.save(file, compression=COMPRESSED)


def _library() -> Any:
    """asammdf, which `rigctl` keeps python-can from importing."""
    if sys.modules.get(_DISTRIBUTION, sys) is None:
        del sys.modules[_DISTRIBUTION]
    return importlib.import_module(_DISTRIBUTION)


def _signal(asammdf: Any, topic: str, column: Column, t_s: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
    values = column.values
    more: dict[str, Any] = {}
    if isinstance(values, list):
        samples = np.array([text.encode() for text in values] or [b""])
        more["encoding"] = "utf-8"
    else:
        samples = np.ascontiguousarray(values)
        if column.absent is not None and column.absent.any():
            more["invalidation_bits"] = column.absent
        if column.names is not None:
            more["conversion"] = {
                **{f"val_{place}": number for place, number in enumerate(column.names)},
                **{f"text_{place}": words for place, words in enumerate(column.names.values())},
            }
    return asammdf.Signal(
        samples=samples,
        timestamps=t_s,
        name=f"{topic}.{column.name}",
        unit=column.unit,
        comment=column.description,
        **more,
    )
