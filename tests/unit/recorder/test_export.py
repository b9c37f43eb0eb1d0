"""``rigctl info`` and ``rigctl export``: their summary of a recording, and files that other programs read back."""

from __future__ import annotations

import json
import pathlib
import subprocess

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import csv
from scipy.io import loadmat

from rigctl.cli import recordings
from rigctl.ipc.output_file import OutputError
from rigctl.ipc.record import RECORD
from rigctl.recorder import export
from rigctl.recorder.columns import Column, tables
from rigctl.recorder.enums import enum_of
from rigctl.recorder.recording import Recording, read
from tests.builders.full_disk import rigctl_with_files_of_at_most
from tests.builders.paths import ROOT
from tests.builders.tape import OFFSET_NS, Tape
from tests.conftest import Command


@pytest.fixture
def tape(tmp_path: pathlib.Path) -> Tape:
    made = Tape(tmp_path)
    made.run(1200)
    made.close()
    return made


@pytest.fixture
def path(tape: Tape) -> pathlib.Path:
    return tape.files()[0]


@pytest.fixture
def found(path: pathlib.Path) -> Recording:
    recording = read(path)
    for name in recording.records.dtype.names or ():
        if name.endswith("_age_ns"):  # the tape's bits are random; an age beyond 2^60 is invalid
            recording.records[name] &= (1 << 40) - 1
    return recording


def test_parquet_holds_every_value_with_its_unit(found: Recording, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "out"
    export.write(found, "parquet", out)
    table = pq.read_table(out / "records.parquet")
    for name in found.records.dtype.names or ():
        named = enum_of(RECORD, name)
        values = found.records[name]
        if named is not None:
            assert table.schema.field(name).type.value_type == pa.string()
            assert table[name].to_pylist() == [named[1].get(n, str(n)) for n in values.tolist()], name
        else:
            assert np.array_equal(table[name].to_numpy(), values, equal_nan=True), name
    assert np.array_equal(table["wall_ns"].to_numpy(), found.records["t_ns"] + OFFSET_NS)
    assert np.diff(table["t_s"].to_numpy()) == pytest.approx(np.diff(found.records["t_ns"]) / 1e9, abs=1e-9)
    for field in RECORD.fields:
        assert table.schema.field(field.name).metadata[b"unit"].decode() == field.unit
    assert table.schema.metadata[b"sha256"].decode() == found.sha256
    frames = pq.read_table(out / "frames.parquet")
    assert frames["data"].to_pylist() == [row.ljust(8, b"\0") for row in found.frames["data"].tolist()]
    events = pq.read_table(out / "events.parquet")
    assert [json.loads(text)["a"] for text in events["details"].to_pylist()] == [
        event.details["a"] for event in found.events
    ]


def test_csv_holds_every_value_under_a_header_with_units(found: Recording, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "out"
    export.write(found, "csv", out)
    wide = {name: "uint64" for name in found.records.dtype.names or () if found.records.dtype[name] == np.uint64}
    table = csv.read_csv(out / "records.csv", convert_options=csv.ConvertOptions(column_types=wide))
    assert "tension_n [N]" in table.column_names
    for field in RECORD.fields:
        name = f"{field.name} [{field.unit}]" if field.unit else field.name
        values = found.records[field.name]
        read_back = np.array(table[name].to_pylist(), values.dtype)
        assert np.array_equal(read_back, values, equal_nan=values.dtype.kind == "f"), name
    frames = csv.read_csv(out / "frames.csv", convert_options=csv.ConvertOptions(column_types={"data": "string"}))
    assert frames["data"].to_pylist() == [row.ljust(8, b"\0").hex() for row in found.frames["data"].tolist()]


@pytest.mark.parametrize("kind", [kind for kind in export.KINDS if kind != "mdf4"])  # test_exports_mdf4.py has it
def test_an_age_of_a_sample_that_never_came_is_null(found: Recording, tmp_path: pathlib.Path, kind: str) -> None:
    found.records["tension_age_ns"][:3] = (1 << 61) + np.arange(3)
    out = tmp_path / "out"
    export.write(found, kind, out)
    if kind == "parquet":
        ages = pq.read_table(out / "records.parquet")["tension_age_ns"].to_pylist()
    elif kind == "csv":
        ages = csv.read_csv(out / "records.csv")["tension_age_ns [ns]"].to_pylist()
    else:
        numbers = loadmat(out / "recording.mat", squeeze_me=True)["records"]["tension_age_ns"].item().tolist()
        ages = [None if np.isnan(number) else number for number in numbers]
    assert ages == [None] * 3 + found.records["tension_age_ns"][3:].tolist()


def test_a_number_without_a_name_is_kept(found: Recording, tmp_path: pathlib.Path) -> None:
    found.records["fault"][0] = 6000
    export.write(found, "parquet", tmp_path / "out")
    assert pq.read_table(tmp_path / "out" / "records.parquet")["fault"][0].as_py() == "6000"


def test_text_that_a_spreadsheet_would_reckon_is_quoted(
    found: Recording, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "plain", "", "a=1"]
    own = {"said": [Column("text", "", "", words), Column("value", "N", "", np.arange(-4.0, 5.0))]}
    monkeypatch.setattr(export, "tables", lambda recording: {**tables(recording), **own})
    export.write(found, "csv", tmp_path / "out")
    options = csv.ParseOptions(newlines_in_values=True)
    table = csv.read_csv(tmp_path / "out" / "said.csv", parse_options=options)
    assert table["text"].to_pylist() == [f"'{text}" for text in words[:6]] + words[6:]
    assert table["value [N]"].to_pylist() == list(range(-4, 5))


def test_mat_holds_a_struct_for_each_topic_and_its_units(found: Recording, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "out"
    export.write(found, "mat", out)
    content = loadmat(out / "recording.mat", squeeze_me=True, struct_as_record=True)
    for name in found.records.dtype.names or ():
        values = content["records"][name].item()
        assert np.array_equal(values, found.records[name], equal_nan=values.dtype.kind == "f"), name
    assert content["units"]["records"].item()["tension_n"].item() == "N"
    assert content["events"]["text"].item().tolist() == [event.text for event in found.events]
    assert content["frames"]["data"].item().tobytes() == found.frames["data"].tobytes()
    assert content["recording"]["rig"].item() == "paper_rig"


@pytest.mark.parametrize("kind", export.KINDS)
def test_every_export_has_the_documents_and_says_what_it_is(
    found: Recording, tmp_path: pathlib.Path, kind: str
) -> None:
    out = tmp_path / "out"
    names = export.write(found, kind, out)
    assert json.loads((out / "recording.json").read_text())["sha256"] == found.sha256
    documents = [path.read_bytes() for path in sorted((out / "attachments").iterdir())]
    assert documents == [item.data for item in found.generations]
    assert sorted(names) == sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())


@pytest.mark.parametrize("kind", export.KINDS)
def test_an_export_that_fails_leaves_nothing(path: pathlib.Path, tmp_path: pathlib.Path, kind: str) -> None:
    folder = tmp_path / "place"
    folder.mkdir()

    words = ["export", str(path), "--to", kind, "-o", str(folder / "out")]
    answer = subprocess.run(
        rigctl_with_files_of_at_most(30_000, words), capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (answer.returncode, answer.stderr.count("\n")) == (2, 1), answer.stderr
    assert "cannot be written: File too large" in answer.stderr
    assert list(folder.iterdir()) == []


def test_nothing_is_overwritten(found: Recording, tmp_path: pathlib.Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OutputError, match="it is there already"):
        export.write(found, "csv", out)
    assert list(out.iterdir()) == []
    with pytest.raises(OutputError, match="there is no folder"):
        export.write(found, "csv", tmp_path / "nowhere" / "out")


def test_info_says_what_is_in_a_recording(path: pathlib.Path, in_process: Command) -> None:
    answer = in_process("rigctl", "info", path, "--json")
    said = json.loads(answer.stdout)
    assert answer.returncode == 0
    assert (said["rig"], said["kind"], said["complete"], said["gaps"]) == ("paper_rig", "recording", True, [])
    assert (said["records"], said["frames"], said["rate_hz"]) == (1200, 4800, 1000.0)
    assert said["duration_s"] == pytest.approx(1.199)
    assert said["start"].startswith("2023-11-14T22:13:")
    assert {item["name"] for item in said["attachments"]} >= {"active.json", "schema.json"}
    assert said["versions"]["numpy"] == np.__version__
    assert sum(mode["for_s"] for mode in said["modes"]) == pytest.approx(1.199)
    text = in_process("rigctl", "info", path)
    assert "complete" in text.stdout.splitlines()[0]
    assert said["sha256"] in text.stdout
    assert "  log       events " in text.stdout
    shown = recordings._lines({**said, "said": {"desk": 2, "events": 1}})
    assert "  log       requests and answers 2, events 1" in shown


def test_info_of_a_cut_file_says_so_and_is_no_failure(path: pathlib.Path, in_process: Command) -> None:
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 3 // 4])
    answer = in_process("rigctl", "info", path)
    assert answer.returncode == 0
    assert "NOT COMPLETE" in answer.stdout
    assert "cut off" in answer.stdout


def test_a_run_is_taken_together(tmp_path: pathlib.Path, in_process: Command) -> None:
    tape = Tape(tmp_path, part_s=1)
    tape.run(3000)
    tape.close()
    first, *others = tape.files()
    assert len(others) >= 2
    alone = json.loads(in_process("rigctl", "info", first, "--json").stdout)
    together = json.loads(in_process("rigctl", "info", first, "--run", "--json").stdout)
    assert alone["records"] < together["records"] == 3000
    assert len(together["files"]) == len(others) + 1
