"""Records as protobuf messages with modes, faults, verdicts and qualities as enumerations, as in a recording."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.ipc.record import RECORD, Field, Slot
from rigctl.recorder.protobuf import Encoding

TOPIC = "/records"
_CODES = {"<f8": "d", "<i8": "q", "<u8": "Q", "<u4": "I", "<u2": "H", "|u1": "B"}
"""Struct code of each numpy type that a record may have."""


class RecordEncoding:
    """Encoding of the records that a daemon serves, which may have other fields than this version's."""

    def __init__(self, types: Mapping[str, str]) -> None:
        """``types``: numpy type of each field in the record's order; those that no record of ours has are left out."""
        known = {name: _CODES[kind] for name, kind in types.items() if name != "seq" and kind in _CODES}
        self._encoding = Encoding(Slot(RECORD.name, tuple(Field(name, code, "", "") for name, code in known.items())))
        self.name = self._encoding.name
        self.schema = base64.b64encode(self._encoding.descriptor()).decode()

    def encode(self, records: npt.NDArray[Any]) -> list[bytes]:
        """One message for each record."""
        return self._encoding.encode(records)


def thinned(records: npt.NDArray[Any], rate_hz: float, loop_hz: float) -> npt.NDArray[Any]:
    """Records at ``rate_hz`` of a loop at ``loop_hz``, by their numbers; all of them where it is not slower."""
    if rate_hz >= loop_hz or not len(records):
        return records
    numbers = records["seq"].astype(np.float64)
    wanted: npt.NDArray[np.bool_] = numbers * rate_hz // loop_hz != (numbers - 1) * rate_hz // loop_hz
    return np.asarray(records[wanted])
