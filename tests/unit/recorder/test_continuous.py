"""Parts begin, end and are deleted by the settings; a full disk is reported, and its gap filled later."""

from __future__ import annotations

import hashlib
import os
import pathlib
import shutil
import subprocess
from collections.abc import Iterator
from itertools import pairwise

import pytest
from mcap.opcode import Opcode

from rigctl.ipc import seal
from rigctl.recorder import parts, recording
from rigctl.recorder.appender import Appender
from rigctl.recorder.contents import figures, seals, seals_in_words
from rigctl.recorder.mcap_scan import Scan
from rigctl.recorder.part_seal import PartStanding
from rigctl.recorder.recording import read
from tests.builders.tape import OFFSET_NS, Tape, as_recorded, same
from tests.builders.waiting import patience_s, until

NEEDS_ROOT = pytest.mark.skipif(
    os.getuid() != 0 or shutil.which("mount") is None, reason="needs root, to mount a small disk"
)


def written(tape: Tape) -> None:
    part = tape.recording._part
    until(lambda: part is None or not part.disk.pending)


def test_parts_are_closed_by_time_and_nothing_is_missing_between_them(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_s=2)
    tape.run(9000)
    tape.close()
    records, frames, _ = tape.held()
    found = read(*tape.files())
    assert 4 <= len(tape.files()) <= 5
    assert all(file.complete for file in found.files)
    assert found.gaps == []
    assert same(found.records, as_recorded(records))
    assert same(found.frames, frames)
    for path in tape.files():  # each can be read alone
        alone = read(path)
        assert alone.attachments.keys() == found.attachments.keys()
        assert alone.end_ns - alone.start_ns < 3e9


def test_parts_are_closed_by_size(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_mb=1)
    tape.run(8000)
    tape.close()
    found = read(*tape.files())
    assert len(found.files) >= 3
    assert all(1_000_000 <= file.size < 1_500_000 for file in found.files[:-1])
    assert len(found.records) == 8000


def test_each_finished_part_is_sealed_and_a_changed_one_is_told(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_mb=1)
    tape.run(8000)
    tape.close()
    first, second, *_ = tape.files()
    found = read(*tape.files())
    assert set(seals(found).values()) == {PartStanding.INTACT}
    assert seals_in_words(found) == "sealed, intact"
    assert seal.key_file(tape.settings, "recording").stat().st_mode & 0o777 == 0o600

    first.write_bytes(_edited(first.read_bytes()))
    found = read(*tape.files())
    assert (seals(found)[first], seals(found)[second]) == (PartStanding.CHANGED, PartStanding.INTACT)
    assert seals_in_words(found).startswith("sealed, intact: ")
    assert seals_in_words(found).endswith(f"changed since it was sealed: {first.name}")
    assert figures(read(first))["files"][0]["seal"] == "changed since it was sealed"


def _edited(content: bytes) -> bytes:
    """A file whose metadata say something else."""
    before = os.uname().release.encode()
    assert before in content
    return content.replace(before, b"?" + before[1:])


@pytest.mark.parametrize("forged", ["new hash", "content after it", "cut off"])
def test_a_file_made_without_the_key_is_not_intact(tmp_path: pathlib.Path, forged: str) -> None:
    tape = Tape(tmp_path, part_mb=1)
    tape.run(8000)
    tape.close()
    first, *_ = tape.files()
    sealed, content = read(first).files[0].seal, first.read_bytes()
    assert sealed is not None
    at = content.rindex(b"seal", 0, content.index(sealed.seal.encode()))
    if forged == "new hash":  # edited, and the hash computed anew, under the old seal
        edited = _edited(content)
        piece = edited.index(sealed.sha256.encode())
        start = next(one.offset for one in Scan(edited).pieces() if one.offset < piece < one.end)
        first.write_bytes(edited.replace(sealed.sha256.encode(), hashlib.sha256(edited[:start]).hexdigest().encode()))
    elif forged == "content after it":
        end = next(one.end for one in Scan(content).pieces() if one.offset < at < one.end)
        chunk = next(one for one in Scan(content).pieces() if one.opcode == Opcode.CHUNK)
        first.write_bytes(content[:end] + content[chunk.offset : chunk.end] + content[end:])
    else:
        first.write_bytes(content[: at - 100])
    said = seals_in_words(read(first))
    assert said == ("no seal" if forged == "cut off" else "changed since it was sealed")


def test_a_seal_on_another_computer_and_a_part_that_was_not_finished(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_mb=1)
    tape.run(8000)
    written(tape)
    assert seals_in_words(read(tape.files()[-1])) == "no seal"
    assert seals_in_words(read(tape.files()[0])) == "sealed, intact"
    tape.close()
    seal.key_file(tape.settings, "recording").unlink()
    assert seals_in_words(read(tape.files()[0])) == "sealed, which cannot be verified here"


def test_the_oldest_parts_of_this_rig_alone_are_deleted(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_mb=1, keep_mb=3)
    tape.folder.mkdir()
    others = [tape.folder / "other_rig-20200101T000000.000Z-0001.mcap", tape.folder / "paper_rig.mcap",
              tape.folder / "paper_rig-20200101T000000.000Z-FAULT.mcap"]  # fmt: skip
    older = tape.folder / "paper_rig-20200101T000000.000Z-0001.mcap"
    for path in (*others, older):
        path.write_bytes(bytes(100_000))
    tape.run(12_000)
    tape.close()
    mine = [part.path for part in parts.parts(tape.folder, "paper_rig")]
    assert older.name in tape.recording.deleted
    assert all(path.exists() for path in others)
    assert 1_000_000 < sum(path.stat().st_size for path in mine) <= 3_500_000
    assert mine[-1].name not in tape.recording.deleted
    numbers = [part.number for part in parts.parts(tape.folder, "paper_rig")]
    assert all(after == before + 1 for before, after in pairwise(numbers))
    assert numbers[0] > 1


def test_a_part_that_is_taken_away_is_followed_by_the_next(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path)
    tape.run(800)
    written(tape)
    (path,) = tape.files()
    path.unlink()
    tape.run(800)
    tape.close()
    (second,) = tape.files()
    assert second.name.endswith("-0002.mcap")
    found = read(second)
    assert found.records["seq"][-1] == 1600
    assert found.records["seq"][0] <= 801


@pytest.fixture
def disk(tmp_path: pathlib.Path) -> Iterator[pathlib.Path]:
    """A disk of 4 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(disk: pathlib.Path) -> pathlib.Path:
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as stream, pytest.raises(OSError, match="No space left"):
        while True:
            stream.write(b"x" * 512)
    return filler


@NEEDS_ROOT
def test_a_full_disk_is_told_and_recording_goes_on_in_the_same_part(tmp_path: pathlib.Path, disk: pathlib.Path) -> None:
    tape = Tape(tmp_path)
    tape.folder.symlink_to(disk)
    tape.recording._has_room = lambda: True  # type: ignore[method-assign]  # or it would stop before
    tape.run(800)
    written(tape)
    filler = fill(disk)
    tape.run(2000)
    part = tape.recording._part
    assert part is not None
    until(lambda: part.disk.failures)
    tape.poll()
    tape.tick(400)
    tape.poll()
    assert "No space left" in tape.recording.why
    assert tape.recording.as_dict()["failures"] >= 1
    filler.unlink()
    until(lambda: not part.disk.error)
    tape.run(800)
    assert tape.recording.why == ""
    tape.close()
    records, frames, _ = tape.held()
    (path,) = [path for path in tape.files() if path.suffix == ".mcap"]
    found = read(path)
    assert found.complete
    assert found.gaps == []
    assert same(found.records, as_recorded(records))
    assert same(found.frames, frames)


@NEEDS_ROOT
def test_it_stops_before_the_disk_is_full_and_goes_on_when_there_is_room(
    tmp_path: pathlib.Path, disk: pathlib.Path
) -> None:
    subprocess.run(["mount", "-o", "remount,size=96m", str(disk)], check=True)
    tape = Tape(tmp_path, free_mib=48)
    tape.folder.symlink_to(disk)
    tape.run(1200)
    written(tape)
    filler = disk / "filler"
    filler.write_bytes(bytes(60 << 20))
    tape.run(2000)
    assert "expected 48 or more" in tape.recording.why or "expected 80 or more" in tape.recording.why
    assert tape.recording.as_dict()["file"] is None
    (first,) = [path for path in tape.files() if path.suffix == ".mcap"]
    assert read(first).complete
    filler.unlink()
    tape.run(1600)
    assert tape.recording.why == ""
    tape.close()
    found = read(*(path for path in tape.files() if path.suffix == ".mcap"))
    assert found.complete
    assert found.gaps == []  # the rings held the data meanwhile
    assert len(found.records) == 4800


def test_a_folder_that_cannot_be_made_is_told_and_tried_again(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path)
    tape.folder.write_text("a file in its place")
    tape.run(2000)
    assert "cannot be written" in tape.recording.why
    tape.folder.unlink()
    tape.run(2000)
    assert tape.recording.why == ""
    tape.close()
    assert len(read(*tape.files()).records) == 4000


@NEEDS_ROOT
def test_a_failed_write_leaves_the_file_as_it_was(disk: pathlib.Path) -> None:
    disk_file = Appender(disk / "file")
    disk_file.append(b"a" * 100_000)
    until(lambda: disk_file.synced == 100_000)
    filler = fill(disk)
    disk_file.append(b"b" * 50_000)
    disk_file.append(b"c" * 50_000)
    until(lambda: disk_file.failures)
    assert disk_file.path.stat().st_size == 100_000
    assert disk_file.pending == 100_000
    filler.unlink()
    until(lambda: not disk_file.pending)
    disk_file.end()
    assert disk_file.join(patience_s())
    assert disk_file.path.read_bytes() == b"a" * 100_000 + b"b" * 50_000 + b"c" * 50_000
    assert disk_file.error == ""


def test_a_recording_of_a_run_is_found_by_any_of_its_parts(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path, part_s=1)
    tape.run(3000)
    tape.close()
    tape.start(run=OFFSET_NS + 10**9)
    tape.run(800)
    tape.close()
    files = tape.files()
    runs = {path.name.split("-")[1] for path in files}
    assert len(runs) == 2
    assert recording.parts_of(files[1]) == tuple(files[:-1])
    assert recording.parts_of(tmp_path / "other.mcap") == (tmp_path / "other.mcap",)


def test_every_recorder_of_a_run_goes_on_with_the_next_number(tmp_path: pathlib.Path) -> None:
    tape = Tape(tmp_path)
    for number in (1, 2, 3):
        tape.run(1000)
        assert (tape.recording.as_dict()["part"], tape.recording.as_dict()["failures"]) == (number, 0)
        tape.close()
        tape.start()
    assert len(tape.files()) == 3
    assert read(*tape.files()).gaps == []
