"""The public slot: 64 bytes that every user reads, and a torn or damaged content is seen."""

from __future__ import annotations

import os
import pathlib
import stat
import threading

import numpy as np
import pytest

from rigctl.ipc import public_slot, record
from rigctl.ipc.folder_places import FolderPlaces
from rigctl.ipc.public_slot import MODE, PUBLIC_SLOT, SLOT_BYTES, PublicSlot, SlotWriter
from rigctl.model.samples import Quality
from rigctl.model.states import Flag
from tests.builders.full_disk import files_of_at_most

FULL = PublicSlot(
    (1 << 62) + 1, 1 << 62, 300.5, 1 << 63, 5, 4, 63, Quality.STALE | Quality.NEVER, Quality.INVALID, True,
    "second force path (node 12)",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> FolderPlaces:
    return FolderPlaces(tmp_path)


def test_every_field_arrives(folder: FolderPlaces) -> None:
    writer = SlotWriter(folder)
    writer.write(FULL)
    assert public_slot.read(folder) == FULL
    writer.close()


def test_a_record_is_shown_as_it_is() -> None:
    newest = np.zeros(1, record.RECORD.dtype)[0]
    for name, value in {"t_ns": 7, "tension_n": 12.5, "mode": 2, "held_by": 1, "fault": 17, "cause_bits": 1 << 17,
                        "tension_quality": 4, "drive_quality": 1, "flags": int(Flag.BRAKE_FAILS)}.items():  # fmt: skip
        newest[name] = value
    shown = public_slot.slot_of(newest, 9, Flag.BRAKE_FAILS)
    assert shown == PublicSlot(9, 7, 12.5, 1 << 17, 2, 1, 17, 4, 1, True)
    assert public_slot.slot_of(None, 9, Flag.BRAKE_FAILS, "gateway") == PublicSlot(9, waits_for="gateway")


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_it_is_64_bytes_that_all_may_read_and_its_owner_alone_write(folder: FolderPlaces, umask: int) -> None:
    before = os.umask(umask)
    try:
        SlotWriter(folder).close()
    finally:
        os.umask(before)
    found = folder.place(PUBLIC_SLOT).stat()
    assert (stat.S_IMODE(found.st_mode), found.st_size) == (MODE, SLOT_BYTES) == (0o644, 64)


def test_every_torn_content_is_refused() -> None:
    before, after = FULL.packed(), PublicSlot(1, 2, 3.0).packed()
    for cut in range(1, SLOT_BYTES):
        for torn in (before[:cut] + after[cut:], after[:cut] + before[cut:]):
            assert PublicSlot.unpacked(torn) is None or torn in (before, after), cut
    assert PublicSlot.unpacked(before[:-1]) is None
    assert PublicSlot.unpacked(before + b"\0") is None
    for at in range(SLOT_BYTES):
        assert PublicSlot.unpacked(before[:at] + bytes([before[at] ^ 1]) + before[at + 1 :]) is None


def test_a_slot_with_other_bits_of_causes_is_refused(folder: FolderPlaces, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(public_slot, "_VERSION", 1)
    former = FULL.packed()
    monkeypatch.undo()
    folder.place(PUBLIC_SLOT).write_bytes(former)
    assert public_slot.read(folder) is None


def test_a_reader_beside_the_writer_finds_whole_contents_alone(folder: FolderPlaces) -> None:
    writer, ended = SlotWriter(folder), threading.Event()
    contents = {PublicSlot(at, at, float(at), at, waits_for=f"{at}" * 9) for at in range(1, 10)}

    def write() -> None:
        while not ended.is_set():
            for content in contents:
                writer.write(content)

    writer.write(next(iter(contents)))
    thread = threading.Thread(target=write)
    thread.start()
    try:
        found = {public_slot.read(folder) for _ in range(5000)} - {None}
    finally:
        ended.set()
        thread.join()
    assert found <= contents
    assert len(found) > 1


@pytest.mark.parametrize("left", ["link", "file", "pipe"])
def test_what_is_left_in_its_place_is_replaced_and_no_link_is_followed(tmp_path: pathlib.Path, left: str) -> None:
    target, folder = tmp_path / "target", FolderPlaces(tmp_path / "rig")
    target.write_bytes(FULL.packed())
    folder.directory.mkdir()
    place = folder.place(PUBLIC_SLOT)
    match left:
        case "link":
            place.symlink_to(target)
        case "file":
            place.write_bytes(b"x" * 100)
        case "pipe":
            os.mkfifo(place)
    assert public_slot.read(folder) is None  # at once, also of a pipe
    writer = SlotWriter(folder)
    writer.write(PublicSlot(5, 4))
    assert target.read_bytes() == FULL.packed()
    assert not place.is_symlink()
    found = public_slot.read(folder)
    assert found is not None
    assert found.t_ns == 4


def test_words_for_a_terminal_alone_are_taken(folder: FolderPlaces) -> None:
    """The folder may be another user's, who writes what he likes into it, with a checksum that is right."""
    folder.place(PUBLIC_SLOT).write_bytes(PublicSlot(1, waits_for="\x1b[2Jno bell\x07").packed())
    assert public_slot.read(folder) is None


def test_words_that_are_too_long_are_cut() -> None:
    packed = PublicSlot(1, tension_n=0.0, waits_for="x" * 100).packed()
    assert len(packed) == SLOT_BYTES
    assert PublicSlot.unpacked(packed) == PublicSlot(1, tension_n=0.0, waits_for="x" * public_slot.WORDS_BYTES)


def test_a_disk_without_room_leaves_the_old_slot_and_the_writer_goes_on(folder: FolderPlaces) -> None:
    """The supervisor had ended with "File too large", and its loop with it."""
    writer = SlotWriter(folder)
    writer.write(FULL)
    with files_of_at_most(0):
        writer.write(FULL._replace(mode=0))
    assert public_slot.read(folder) == FULL
    writer.write(FULL._replace(mode=0))
    assert public_slot.read(folder) == FULL._replace(mode=0)
    writer.close()
