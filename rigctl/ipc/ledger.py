"""The ledger: every tare, calibration check and identification of one rig, in a JSON file that only grows.

Only the gateway writes it, whole or not at all (new file, fsync, rename); supervisor and gateway read it at their
start. The last entry with zero and scale gives these; the last calibration check gives the date until which the cell
is believed.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

from rigctl import __version__
from rigctl.config import input_file
from rigctl.config.built_type import built
from rigctl.config.one_line import printable
from rigctl.config.settings import RigSettings
from rigctl.ipc import seal, wall_clock, whole_file
from rigctl.ipc.correction import (
    CREEP_BOUND,
    CREEP_FASTEST_S,
    CREEP_SLOWEST_S,
    SCALE_BOUND,
    Correction,
    CreepTerm,
    creep_fits,
)
from rigctl.ipc.runtime_folder import Runtime

IN_FORCE = "calibration.json"  # in the runtime folder
CREEP = ("creep_1", "creep_1_s", "creep_2", "creep_2_s")
"""Names of the creep's shares and time constants in an entry."""
_SEALED = seal.LEDGER  # what the seal is about
_LARGEST_BYTES = 64 << 20  # a hundred years of a tare an hour


class LedgerError(RuntimeError):
    """The file cannot be read, written or believed; ``str()`` is one line."""


@built
class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One entry: action, time, operator, correction before and after, and the figures behind it.

    ``after`` holds ``zero_n`` and ``scale`` where they are in force from then on, the creep where that is (`CREEP`),
    and their expanded uncertainties (k = 2) where they are known; ``passed`` is None for an entry that is no check.
    ``settings`` is the digest of the settings then in use.
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


@built
class _LedgerFile(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    rig: str
    entries: list[Entry]
    seal: str = ""

    @property
    def sealed(self) -> bytes:
        """What the seal is about."""
        return msgspec.json.encode([self.rig, self.entries], order="sorted")


@built
@dataclass(frozen=True)
class Standing:
    """The ledger's values now. ``due`` and ``tared``: ISO 8601 UTC, None without a passed check or without a tare.

    Uncertainties are expanded (k = 2), None where the ledger has none: ``zero_u_n`` of the tare, ``zero_u_n_k`` of the
    drift with temperature, ``scale_u`` and ``creep_u`` as shares of the load. ``zero_c``: the cell's temperature at the
    tare. ``creep_seen_s``: how long the creep was recorded, and so known.
    """

    zero_n: float = 0.0
    scale: float = 1.0
    due: str | None = None
    overdue: bool = False
    waiver: str | None = None
    tared: str | None = None
    zero_u_n: float | None = None
    zero_c: float | None = None
    zero_n_k: float = 0.0
    zero_u_n_k: float | None = None
    scale_u: float | None = None
    creep: tuple[CreepTerm, ...] = ()
    creep_u: float | None = None
    creep_seen_s: float | None = None
    second_zero_n: float | None = None
    second_scale: float = 1.0

    @property
    def correction(self) -> Correction:
        """The correction for the loop."""
        overdue = self.overdue and self.waiver is None
        return Correction(
            self.zero_n, self.scale, overdue, self.creep, self.zero_c, self.zero_n_k, self.second_zero_n,
            self.second_scale,
        )  # fmt: skip

    @property
    def pair(self) -> dict[str, float | None]:
        """Zero and scale with what belongs to them, as entries hold them; what is not known is not in it."""
        known = {"zero_n": self.zero_n, "scale": self.scale, "zero_u_n": self.zero_u_n, "zero_c": self.zero_c}
        known |= {"zero_n_k": self.zero_n_k or None, "zero_u_n_k": self.zero_u_n_k, "scale_u": self.scale_u}
        if self.second_zero_n is not None:
            known |= {"second_zero_n": self.second_zero_n, "second_scale": self.second_scale}
        return {name: value for name, value in known.items() if value is not None}

    @property
    def crept(self) -> dict[str, float | None]:
        """The creep as entries hold it, two shares of 0 for none."""
        terms = self.creep or (CreepTerm(0.0, CREEP_FASTEST_S),) * 2
        values = [value for term in terms for value in term]
        found: dict[str, float | None] = dict(zip(CREEP, values, strict=True))
        known = {"creep_u": self.creep_u, "creep_seen_s": self.creep_seen_s}
        return found | {name: value for name, value in known.items() if value is not None}


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


def read(settings: RigSettings, file: pathlib.Path | None = None) -> list[Entry]:
    """Every entry, oldest first; none without a calibration section or before the first.

    ``file``: a copy of the rig's ledger elsewhere, whose seal cannot be verified there and is not.

    Raises:
        LedgerError: unreadable, not a ledger, another rig's, or with a zero or scale out of bounds.
    """
    path = file or settings.ledger
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
    if file is None:
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
    creep = _creep_of(item.after)
    if creep is not None and not creep_fits(creep):
        raise LedgerError(
            f"{path}: entry {number}: found creep {item.after}, expected shares within {CREEP_BOUND:g} and times of "
            f"{CREEP_FASTEST_S:g} to {CREEP_SLOWEST_S:g} s"
        )
    pair = item.after.get("zero_n"), item.after.get("scale")
    if pair == (None, None):
        return
    zero_n, scale = pair
    if not _correction_fits(item.after, settings):
        limit = settings.tare_limit_n
        raise LedgerError(
            f"{path}: entry {number}: found zero {zero_n} N and scale {scale}, expected {-limit:g} to {limit:g} N and "
            f"{1 - SCALE_BOUND:g} to {1 + SCALE_BOUND:g}"
        )


def _correction_fits(after: dict[str, float | None], settings: RigSettings) -> bool:
    zero_n, scale = after.get("zero_n"), after.get("scale")
    if zero_n is None or scale is None:
        return False
    drift_n_k = after.get("zero_n_k") or 0.0
    second_scale = after.get("second_scale")
    return Correction(
        zero_n, scale, zero_c=after.get("zero_c"), zero_n_k=drift_n_k, second_zero_n=after.get("second_zero_n"),
        second_scale=1.0 if second_scale is None else second_scale,
    ).fits(settings)  # fmt: skip


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
    due = None
    pair: dict[str, float | None] = {"zero_n": 0.0, "scale": 1.0}
    crept: dict[str, float | None] = {}
    now = datetime.fromtimestamp(wall_ns / 1e9, UTC)
    for item in entries:
        if item.after.get("zero_n") is not None and item.after.get("scale") is not None:
            pair = item.after
        if _creep_of(item.after) is not None:
            crept = item.after
        if item.passed is not None:
            valid = timedelta(days=settings.calibration.due_days)
            due = min(moment(item.when), datetime.max.replace(tzinfo=UTC) - valid) + valid if item.passed else None
    shown = f"{due:%Y-%m-%dT%H:%M:%SZ}" if due is not None else None
    section = settings.compensation
    zero_n_k, zero_u_n_k = pair.get("zero_n_k") or 0.0, pair.get("zero_u_n_k")
    if section is not None and section.zero_n_k is not None:
        zero_n_k, zero_u_n_k = section.zero_n_k, section.zero_u_n_k
    return Standing(
        pair["zero_n"] or 0.0,
        1.0 if pair["scale"] is None else pair["scale"],
        shown,
        is_overdue(settings, shown, now),
        settings.calibration.waiver,
        _tared(entries),
        zero_u_n=pair.get("zero_u_n"),
        zero_c=pair.get("zero_c"),
        zero_n_k=zero_n_k,
        zero_u_n_k=zero_u_n_k,
        scale_u=pair.get("scale_u"),
        creep=_creep_of(crept) or (),
        creep_u=crept.get("creep_u"),
        creep_seen_s=crept.get("creep_seen_s"),
        second_zero_n=pair.get("second_zero_n"),
        second_scale=1.0 if pair.get("second_scale") is None else pair["second_scale"] or 1.0,
    )


def is_overdue(settings: RigSettings, due: str | None, now: datetime) -> bool:
    """Whether a calibration that is ``due`` then is overdue; not where `clock_doubt` warns of its age instead."""
    if settings.calibration is None or due is None:
        return settings.calibration is not None
    valid = timedelta(days=settings.calibration.due_days)
    age = wall_clock.age(moment(due) - valid, now)
    return age is not None and age >= valid


def clock_doubt(settings: RigSettings, design: object, now: datetime, known: Standing | None = None) -> str:
    """See `wall_clock.doubt`, for the dates of ledger and gains.

    ``design``: as in `ACTIVE`, if known. ``known``: None to read the ledger; one that cannot be read has no dates.
    """
    if known is None:
        known = Standing()
        with contextlib.suppress(LedgerError):
            known = standing(settings, read(settings), round(now.timestamp() * 1e9))
    found = {}
    if settings.calibration is not None and known.due is not None:
        found["the last calibration check"] = moment(known.due) - timedelta(days=settings.calibration.due_days)
    if settings.calibration is not None and known.tared is not None:
        found["the last tare"] = moment(known.tared)
    match design:
        case {"source": {"file": file, "provenance": {"date_utc": made}, "identified": [*identified]}}:
            named = [
                (f"the gains of {file}", made),
                *((f"the identification of {str(at)[:10]}", at) for at in identified),
            ]
            for what, when in named:
                with contextlib.suppress(ValueError):  # a gain file may have any text
                    found[what] = moment(str(when))
    return wall_clock.doubt(now, found)


def _creep_of(values: dict[str, float | None]) -> tuple[CreepTerm, ...] | None:
    """The creep in the values of an entry: no terms where both shares are 0, None where the entry is about none."""
    found = [values.get(name) for name in CREEP]
    if all(value is None for value in found):
        return None
    first, first_s, second, second_s = (math.nan if value is None else value for value in found)
    return () if first == second == 0.0 else (CreepTerm(first, first_s), CreepTerm(second, second_s))


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
