"""The ledger: every tare, calibration check and identification of one rig, in a JSON file that only grows.

Only the gateway writes it, whole or not at all (new file, fsync, rename); supervisor and gateway read it at their
start. The last entry with zero and scale gives these; the last calibration check gives the date until which the cell
is believed.
"""

from __future__ import annotations

import hashlib
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

from rigctl import __version__
from rigctl.config import input_file
from rigctl.config.one_line import printable
from rigctl.config.settings import RigSettings
from rigctl.ipc import seal, whole_file
from rigctl.ipc.correction import SCALE_BOUND, Correction, tare_limit_n
from rigctl.ipc.runtime_folder import Runtime

IN_FORCE = "calibration.json"  # in the runtime folder
_SEALED = seal.LEDGER  # what the seal is about
_LARGEST_BYTES = 64 << 20  # a hundred years of a tare an hour
CLOCKS_DIFFER = timedelta(days=1)  # at most, between the wall clocks of two starts


class LedgerError(RuntimeError):
    """The file cannot be read, written or believed; ``str()`` is one line."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One entry: action, time, operator, correction before and after, and the figures behind it.

    ``after`` holds ``zero_n`` and ``scale`` where they are in force from then on; ``passed`` is None for an entry
    that is no check. ``settings`` is the digest of the settings then in use.
    """

    what: str
    when: str
    operator: str
    rig: str
    version: str
    settings: str
    before: dict[str, float | None]
    after: dict[str, float | None]
    figures: dict[str, Any]
    passed: bool | None = None


class _LedgerFile(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    rig: str
    entries: list[Entry]
    seal: str = ""

    @property
    def sealed(self) -> bytes:
        """What the seal is about."""
        return msgspec.json.encode([self.rig, self.entries], order="sorted")


@dataclass(frozen=True)
class Standing:
    """The ledger's values now. ``due`` and ``tared``: ISO 8601 UTC, None without a passed check or without a tare."""

    zero_n: float = 0.0
    scale: float = 1.0
    due: str | None = None
    overdue: bool = False
    waiver: str | None = None
    tared: str | None = None

    @property
    def correction(self) -> Correction:
        """The correction for the loop."""
        return Correction(self.zero_n, self.scale, self.overdue and self.waiver is None)


def in_force(runtime: Runtime, before: Standing | None = None) -> Standing:
    """The values that supervisor or gateway last put in force; before that, the uncorrected cell.

    ``before``: kept if the file is invalid; without it the uncorrected cell, which does not arm.
    """
    try:
        return msgspec.convert(runtime.read_json(IN_FORCE), Standing)
    except (OSError, msgspec.MsgspecError):
        return before if before is not None else Standing(overdue=True)


def utc(wall_ns: int) -> str:
    """A wall-clock time in the ledger's format."""
    return f"{datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC):%Y-%m-%dT%H:%M:%SZ}"


def entry(
    settings: RigSettings,
    what: str,
    operator: str,
    wall_ns: int,
    *,
    before: dict[str, float | None],
    after: dict[str, float | None],
    figures: dict[str, Any],
    passed: bool | None = None,
) -> Entry:
    """An entry with the present time."""
    return Entry(
        what, utc(wall_ns), operator, settings.rig, __version__, digest(settings), before, after, figures, passed
    )


def digest(settings: RigSettings) -> str:
    """SHA-256 of the settings, without the file's folder."""
    plain = settings.model_dump(mode="json", exclude={"directory"})
    return hashlib.sha256(msgspec.json.encode(plain, order="sorted")).hexdigest()


def entry_digest(item: Entry) -> str:
    """SHA-256 of an entry as JSON with sorted keys."""
    return hashlib.sha256(msgspec.json.encode(item, order="sorted")).hexdigest()


def read(settings: RigSettings) -> list[Entry]:
    """Every entry, oldest first; none without a calibration section or before the first.

    Raises:
        LedgerError: unreadable, not a ledger, another rig's, or with a zero or scale out of bounds.
    """
    path = settings.ledger
    if path is None:
        return []
    try:
        found: _LedgerFile = input_file.decoded(input_file.read(path, largest=_LARGEST_BYTES, links=True), _LedgerFile)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise LedgerError(f"{path}: cannot be read: {error.strerror}") from None
    except msgspec.MsgspecError as error:
        raise LedgerError(f"{path}: no calibration ledger: {printable(' '.join(str(error).split()))}") from None
    if found.rig != settings.rig:
        raise LedgerError(f"{path}: found the ledger of {found.rig!r}, expected that of {settings.rig!r}")
    for number, item in enumerate(found.entries, 1):
        _check(path, number, item, settings)
    _check_seal(settings, path, found)
    return found.entries


def _check_seal(settings: RigSettings, path: pathlib.Path, found: _LedgerFile) -> None:
    """Refuse a ledger that was edited since it was sealed; one from before there were seals is believed."""
    try:
        verdict = seal.verdict(settings, _SEALED, found.sealed, found.seal)
    except seal.SealError as error:
        raise LedgerError(str(error)) from None
    if verdict is seal.SealVerdict.BROKEN:
        key = seal.key_file(settings, _SEALED)
        raise LedgerError(
            f"{path}: its seal is not that of its entries: somebody else edited it; restore a copy, or if it is right, "
            f'delete {key} and its "seal"'
        )


def _check(path: pathlib.Path, number: int, item: Entry, settings: RigSettings) -> None:
    """Refuse an entry with a zero or scale out of bounds, or an invalid date."""
    try:
        moment(item.when)
    except ValueError:
        raise LedgerError(f"{path}: entry {number}: found the date {item.when!r}, expected ISO 8601") from None
    pair = item.after.get("zero_n"), item.after.get("scale")
    if pair == (None, None):
        return
    zero_n, scale = pair
    if zero_n is None or scale is None or not Correction(zero_n, scale).fits(settings):
        limit = tare_limit_n(settings)
        raise LedgerError(
            f"{path}: entry {number}: found zero {zero_n} N and scale {scale}, expected {-limit:g} to {limit:g} N and "
            f"{1 - SCALE_BOUND:g} to {1 + SCALE_BOUND:g}"
        )


def append(settings: RigSettings, new: Entry) -> list[Entry]:
    """Write one more entry; returns all.

    Raises:
        LedgerError: the entry could not be written; the file is unchanged.
    """
    path = settings.ledger
    if path is None:
        raise LedgerError("the rig file has no calibration section")
    entries = [*read(settings), new]
    made = _LedgerFile(settings.rig, entries)
    try:
        made.seal = seal.seal(settings, _SEALED, made.sealed)
        data = msgspec.json.format(msgspec.json.encode(made), indent=1) + b"\n"
        whole_file.replace(path, data, mode=0o666)
    except seal.SealError as error:
        raise LedgerError(str(error)) from None
    except OSError as error:
        raise LedgerError(f"{path}: cannot be written: {error.strerror}") from None
    return entries


def standing(settings: RigSettings, entries: Sequence[Entry], wall_ns: int) -> Standing:
    """Values at ``wall_ns``: the newest zero and scale, and the due date of the newest check if it passed."""
    if settings.calibration is None:
        return Standing()
    zero_n, scale, due = 0.0, 1.0, None
    now = datetime.fromtimestamp(wall_ns / 1e9, UTC)
    for item in entries:
        if (zero := item.after.get("zero_n")) is not None and (factor := item.after.get("scale")) is not None:
            zero_n, scale = zero, factor
        if item.passed is not None:
            done = moment(item.when)
            credible = item.passed and done <= now + CLOCKS_DIFFER  # a check dated in the future would hold too long
            due = done + timedelta(days=settings.calibration.due_days) if credible else None
    shown = f"{due:%Y-%m-%dT%H:%M:%SZ}" if due is not None else None
    return Standing(zero_n, scale, shown, due is None or due <= now, settings.calibration.waiver, _tared(entries))


def _tared(entries: Sequence[Entry]) -> str | None:
    """Time of the tare in force; a withdrawn tare is not."""
    withdrawn = {item.figures.get("withdraws") for item in entries if item.what == "tare withdrawn"}
    return next((item.when for item in reversed(entries) if item.what == "tare" and item.when not in withdrawn), None)


def moment(when: str) -> datetime:
    """A date of the ledger, with its time zone.

    Raises:
        ValueError: the text is no date.
    """
    found = datetime.fromisoformat(when)
    if found.tzinfo is None:
        raise ValueError("no time zone")
    return found
