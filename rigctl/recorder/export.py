"""Export of a recording as Parquet, CSV, MAT or MDF4; the folder is complete or absent."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import shutil
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl.ipc.output_file import OutputError
from rigctl.recorder.columns import Column, tables
from rigctl.recorder.contents import figures
from rigctl.recorder.enums import Names
from rigctl.recorder.recording import Recording

if TYPE_CHECKING:
    import pyarrow as pa

Tables = dict[str, list[Column]]
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def check(out: pathlib.Path) -> None:
    """Refuse a folder that exists or cannot be created.

    Raises:
        OutputError: the message is one line that names it.
    """
    try:
        if out.is_symlink() or out.exists():
            raise FileExistsError(errno.EEXIST, "it is there already")
        if not os.access(out.parent, os.W_OK | os.X_OK):
            refused = errno.EACCES if out.parent.is_dir() else errno.ENOENT
            raise OSError(refused, os.strerror(refused))
    except OSError as error:
        raise OutputError(out, error, "-o") from None


def write(recording: Recording, kind: str, out: pathlib.Path) -> list[str]:
    """Write the folder ``out``; returns the names of its files.

    Args:
        recording: the recording to export.
        kind: one of ``KINDS``.
        out: a folder that does not exist yet.

    Raises:
        OutputError: it cannot be written; no part of it is left.
    """
    check(out)
    part = out.with_name(f".{out.name}.part-{os.getpid()}")
    try:
        part.mkdir()
        KINDS[kind](recording, tables(recording), part)
        documents = part / "attachments"
        documents.mkdir()
        for number, item in enumerate(recording.generations):
            (documents / f"{number:03d}-{pathlib.PurePath(item.name).name or 'unnamed'}").write_bytes(item.data)
        text = msgspec.json.format(msgspec.json.encode(figures(recording)), indent=2)
        (part / "recording.json").write_bytes(text + b"\n")
        check(out)
        part.rename(out)
    except OSError as error:  # pyarrow adds its own text to the system's message
        code = error.errno
        raise OutputError(out, error if code is None else OSError(code, os.strerror(code)), "-o") from None
    finally:
        with contextlib.suppress(OSError):
            shutil.rmtree(part)
    return sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())


def _arrow(columns: list[Column], words: dict[str, str], *, text: bool) -> pa.Table:
    """``text``: for CSV, which has no bytes, enumerations and metadata: hexadecimal, numbers, units in the header."""
    import pyarrow as pa

    arrays, fields = [], []
    for column in columns:
        values = column.values
        if isinstance(values, np.ndarray) and values.ndim == 2:
            rows = [bytes(row) for row in values]
            array = pa.array([row.hex() for row in rows] if text else rows)
        elif isinstance(values, list):
            array = pa.array([_cell(item) for item in values] if text else values)
        elif column.names is not None and not text:
            array = _dictionary(values, column.names)
        else:
            array = pa.array(values, mask=column.absent)
        name = f"{column.name} [{column.unit}]" if text and column.unit else column.name
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata={"unit": column.unit, "description": column.description}))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=words))


def _dictionary(values: npt.NDArray[Any], names: Names) -> pa.Array:
    """Numbers of an enumeration as their names; a number without a name is given as text."""
    import pyarrow as pa

    known, places = np.unique(values, return_inverse=True)
    words = [names.get(number, str(number)) for number in known.tolist()]
    return pa.DictionaryArray.from_arrays(pa.array(places.astype(np.int32)), pa.array(words, pa.string()))


def _cell(text: str) -> str:
    """Text that a spreadsheet only shows: one that begins as a formula would be evaluated, and may call a program."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def _words(recording: Recording) -> dict[str, str]:
    return {"rig": recording.rig, "run": recording.run, "sha256": recording.sha256,
            "wall_offset_ns": str(recording.wall_offset_ns)}  # fmt: skip


def _parquet(recording: Recording, found: Tables, folder: pathlib.Path) -> None:
    import pyarrow.parquet as pq

    for topic, columns in found.items():
        table = _arrow(columns, _words(recording), text=False)
        pq.write_table(table, folder / f"{topic}.parquet", compression="zstd")


def _csv(recording: Recording, found: Tables, folder: pathlib.Path) -> None:
    from pyarrow import csv

    for topic, columns in found.items():
        csv.write_csv(_arrow(columns, _words(recording), text=True), folder / f"{topic}.csv")


def _mat(recording: Recording, found: Tables, folder: pathlib.Path) -> None:
    from scipy.io import savemat

    content: dict[str, Any] = {"recording": _words(recording)}
    units: dict[str, dict[str, str]] = {}
    descriptions: dict[str, dict[str, str]] = {}
    for topic, columns in found.items():
        content[topic] = {column.name: _for_matlab(column) for column in columns}
        units[topic] = {column.name: column.unit for column in columns}
        descriptions[topic] = {column.name: column.description for column in columns}
    content |= {"units": units, "descriptions": descriptions}
    savemat(folder / "recording.mat", content, long_field_names=True, do_compression=True, oned_as="column")


def _mdf4(recording: Recording, found: Tables, folder: pathlib.Path) -> None:
    from rigctl.recorder import mdf4

    mdf4.write(recording, found, folder / "recording.mf4")


def _for_matlab(column: Column) -> Any:
    values = column.values
    if column.absent is not None and isinstance(values, np.ndarray) and column.absent.any():
        return np.where(column.absent, np.nan, values)  # MAT has no other null
    if isinstance(values, list):
        cells = np.empty(len(values), object)
        cells[:] = values
        return cells
    return values


KINDS: dict[str, Callable[[Recording, Tables, pathlib.Path], None]] = {
    "parquet": _parquet,
    "csv": _csv,
    "mat": _mat,
    "mdf4": _mdf4,
}
