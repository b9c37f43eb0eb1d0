"""``rigctl export --to mdf4``, read back by asammdf."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from rigctl.ipc.record import RECORD
from rigctl.recorder import export, mdf4
from rigctl.recorder.columns import tables
from rigctl.recorder.enums import enum_of
from rigctl.recorder.recording import Recording, read
from tests.builders.tape import Tape


@pytest.fixture
def found(tmp_path: pathlib.Path) -> Recording:
    tape = Tape(tmp_path)
    tape.run(300)
    tape.close()
    recording = read(tape.files()[0])
    for name in recording.records.dtype.names or ():
        if name.endswith("_age_ns"):  # the tape's bits are random; an age beyond 2^60 is invalid
            recording.records[name] &= (1 << 40) - 1
    recording.records["tension_age_ns"][:3] = 1 << 61
    return recording


def test_every_value_comes_back_with_its_unit_and_names(found: Recording, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "out"
    assert "recording.mf4" in export.write(found, "mdf4", out)
    asammdf = mdf4._library()
    with asammdf.MDF(out / "recording.mf4") as mdf:
        assert mdf.version == "4.10"
        assert mdf.start_time.timestamp() == pytest.approx((found.start_ns + found.wall_offset_ns) * 1e-9, abs=1e-3)
        groups = {group.channel_group.acq_name for group in mdf.groups}
        assert groups == set(tables(found))
        t_s = (found.records["t_ns"] - found.start_ns) * 1e-9
        for field in RECORD.fields:
            raw = mdf.get(f"records.{field.name}", raw=True, ignore_invalidation_bits=True)
            assert raw.unit == field.unit
            assert raw.comment == field.description
            np.testing.assert_array_equal(raw.samples, found.records[field.name], field.name)
            np.testing.assert_allclose(raw.timestamps, t_s, atol=1e-9)
            if (named := enum_of(RECORD, field.name)) is not None:
                shown = [bytes(one).decode() for one in mdf.get(f"records.{field.name}").samples]
                known = [
                    (named[1].get(number), words) for number, words in zip(raw.samples.tolist(), shown, strict=True)
                ]
                assert all(name in (None, words) for name, words in known), field.name
        ages = mdf.get("records.tension_age_ns")
        assert len(ages.samples) == len(found.records) - 3  # the absent ones are left out
        if found.events:
            texts = [bytes(one).decode() for one in mdf.get("events.text").samples]
            assert texts == [event.text for event in found.events]
