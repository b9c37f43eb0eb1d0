"""The seal of a rig's files: who edits one without the key is noticed."""

from __future__ import annotations

import os
import pathlib
import subprocess

import msgspec
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger, seal
from rigctl.ipc.ledger import LedgerError
from rigctl.ipc.seal import SealError, SealVerdict
from rigctl.recorder import sealed_head
from rigctl.recorder.audit_log import AuditLog, Item
from rigctl.recorder.chain import read_line, verify
from tests.builders.paths import ROOT

NOBODY = 65534


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    found = config.load(ROOT / "config/paper_rig.yaml").model_copy(update={"directory": tmp_path})
    assert found.ledger is not None
    return found


def tare(settings: RigSettings, zero_n: float) -> None:
    after: dict[str, float | None] = {"zero_n": zero_n, "scale": 1.0}
    ledger.append(settings, ledger.entry(settings, "tare", "kim", 0, before={}, after=after, figures={}))


def test_every_entry_is_sealed_with_a_key_that_only_its_owner_reads(settings: RigSettings) -> None:
    tare(settings, 0.5)
    tare(settings, 0.6)
    assert seal.key_file(settings, "ledger").stat().st_mode & 0o777 == 0o600
    assert [item.after["zero_n"] for item in ledger.read(settings)] == [0.5, 0.6]


@pytest.mark.parametrize("edit", ["zero", "removed", "stripped", "key"])
def test_a_ledger_that_somebody_edited_is_not_believed(settings: RigSettings, edit: str) -> None:
    tare(settings, 0.5)
    tare(settings, 0.6)
    path = settings.ledger
    assert path is not None
    content = msgspec.json.decode(path.read_bytes())
    if edit == "zero":
        content["entries"][1]["after"]["zero_n"] = 3.0
    elif edit == "removed":
        del content["entries"][1]
    elif edit == "stripped":
        del content["seal"]
    else:
        seal.key_file(settings, "ledger").unlink()
    path.write_bytes(msgspec.json.encode(content))
    with pytest.raises(LedgerError, match="its seal is not that of its entries") as refused:
        ledger.read(settings)
    assert "\n" not in str(refused.value)
    with pytest.raises(LedgerError):
        tare(settings, 0.7)


def test_a_ledger_from_before_there_were_seals_is_believed_and_sealed(settings: RigSettings) -> None:
    tare(settings, 0.5)
    path = settings.ledger
    assert path is not None
    content = msgspec.json.decode(path.read_bytes())
    del content["seal"]
    path.write_bytes(msgspec.json.encode(content))
    seal.key_file(settings, "ledger").unlink()
    assert len(ledger.read(settings)) == 1
    tare(settings, 0.6)
    assert len(ledger.read(settings)) == 2
    assert seal.key_file(settings, "ledger").exists()


def test_a_key_that_others_could_have_read_or_made_is_refused(settings: RigSettings, tmp_path: pathlib.Path) -> None:
    tare(settings, 0.5)
    key = seal.key_file(settings, "ledger")
    key.chmod(0o640)
    with pytest.raises(LedgerError, match="found user 0 and mode 0640, expected a file of user 0 with mode 0600"):
        ledger.read(settings)
    other = tmp_path / "other"
    key.chmod(0o600)
    key.rename(other)
    key.symlink_to(other)
    with pytest.raises(SealError):
        seal.seal(settings, "ledger", b"")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_can_neither_read_the_key_nor_make_a_seal(settings: RigSettings) -> None:
    tare(settings, 0.5)
    become = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
    assert subprocess.run(
        [*become, "cat", str(seal.key_file(settings, "ledger"))], capture_output=True, check=False
    ).returncode
    assert seal.verdict(settings, "ledger", b"", "0" * 64) is SealVerdict.BROKEN


def test_the_sealed_head_of_the_audit_log_shows_a_log_cut_off_or_computed_anew(
    settings: RigSettings,
) -> None:
    log = AuditLog(settings.audit_log, settings.rig)
    log.open()
    items = [Item(number, number, "test", str(number)) for number in range(3)]
    log.append(items, [{"run": 1}] * 3)
    log.close()
    assert sealed_head.read(settings) is None  # never sealed yet
    sealed_head.write(settings, log.entries, log.head)
    assert sealed_head.read(settings) == log.head
    lines = settings.audit_log.read_bytes().splitlines(keepends=True)
    assert verify(lines, sealed_head.read(settings)).good
    assert "truncated" in verify(lines[:2], sealed_head.read(settings)).why
    found = msgspec.json.decode(sealed_head.head_file(settings).read_bytes())
    forged = msgspec.json.encode(found | {"entries": 2, "head": read_line(lines[1])[1]})
    sealed_head.head_file(settings).write_bytes(forged)
    with pytest.raises(SealError, match="somebody else wrote it"):
        sealed_head.read(settings)
    sealed_head.head_file(settings).unlink()
    with pytest.raises(SealError, match="is gone, though the rig has a key"):
        sealed_head.read(settings)
