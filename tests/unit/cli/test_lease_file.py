"""The command line's lease file: shared by one user's terminals, and never a reason to fail."""

from __future__ import annotations

import os
import pathlib

import pytest

from rigctl.cli.lease_file import LeaseFile, folder

ID, OTHER = "0" * 32, "1" * 32
ENDPOINT = "tcp/127.0.0.1:7447"


@pytest.fixture(autouse=True)
def own_folder(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    return tmp_path / "run" / "rigctl"


def test_an_id_is_kept_for_one_rig_endpoint_and_operator(own_folder: pathlib.Path) -> None:
    kept = LeaseFile("paper_rig", ENDPOINT, "anna")
    assert kept.read() is None
    kept.forget()
    kept.write(ID)
    kept.write(OTHER)
    assert LeaseFile("paper_rig", ENDPOINT, "anna").read() == OTHER
    assert kept.path.stat().st_mode & 0o777 == 0o600
    assert own_folder.stat().st_mode & 0o777 == 0o700
    others = (("other", ENDPOINT, "anna"), ("paper_rig", "tcp/h:1", "anna"), ("paper_rig", ENDPOINT, "kim"))
    assert [LeaseFile(*other).read() for other in others] == [None] * 3
    assert [file.name for file in own_folder.iterdir()] == [kept.path.name]
    kept.forget()
    assert kept.read() is None


@pytest.mark.parametrize("found", [b"", b"\xff\xfe", b"garbage\n", b"0" * 33, b"0" * 10_000])
def test_what_is_no_id_is_not_shown(own_folder: pathlib.Path, found: bytes) -> None:
    kept = LeaseFile("paper_rig", ENDPOINT, "anna")
    own_folder.mkdir(mode=0o700, parents=True)
    kept.path.write_bytes(found)
    assert kept.read() is None
    kept.write(ID)
    assert kept.read() == ID


def test_a_file_another_could_have_put_there_is_not_read(own_folder: pathlib.Path, tmp_path: pathlib.Path) -> None:
    kept = LeaseFile("paper_rig", ENDPOINT, "anna")
    kept.write(ID)
    own_folder.chmod(0o755)  # readable by others
    assert kept.read() is None
    own_folder.chmod(0o700)
    assert kept.read() == ID
    (tmp_path / "elsewhere").write_text(OTHER)
    kept.path.unlink()
    kept.path.symlink_to(tmp_path / "elsewhere")
    assert kept.read() is None
    kept.path.unlink()
    os.mkfifo(kept.path)
    assert kept.read() is None


def test_where_nothing_can_be_kept_nothing_fails(own_folder: pathlib.Path) -> None:
    own_folder.parent.mkdir()
    own_folder.write_text("a file, not a folder")
    kept = LeaseFile("paper_rig", ENDPOINT, "anna")
    kept.write(ID)
    kept.forget()
    assert kept.read() is None


@pytest.mark.parametrize("given", [None, "", "relative/folder"])
def test_without_a_runtime_folder_there_is_one_by_user(monkeypatch: pytest.MonkeyPatch, given: str | None) -> None:
    if given is None:
        monkeypatch.delenv("XDG_RUNTIME_DIR")
    else:
        monkeypatch.setenv("XDG_RUNTIME_DIR", given)
    assert folder().name == f"rigctl-{os.getuid()}"
