"""The part of the preflight the loop cannot make itself: files, margins, what the system granted, room on the disks.

The gateway judges it in a thread of its own, twice a second and more often while something fails, because a disk may
be slow; the loop is told when it changes and before every ARM (`rigctl.control.modes.Setting.HOST_CHECKS`).
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

from rigctl.config.settings import RigSettings
from rigctl.control.checks import HOST_CHECKS, Check
from rigctl.ipc.ledger import CLOCKS_DIFFER, Standing, moment
from rigctl.ipc.runtime_folder import ACTIVE, Runtime

CONTROL = "control.json"
LOOK_S, LOOK_AGAIN_S = 0.5, 0.1  # between two looks, and while something fails
FIRST_LOOK_S = 1.0  # a gateway that starts waits so long for the first
STALE_NS = 2_000_000_000  # a look older than this is none: a disk that hangs does not arm a rig
MIB = 1 << 20


@dataclass(frozen=True)
class Verdict:
    """What fails, in words that say what to do, and what would but for a waiver, in the waiver's words."""

    failing: Mapping[Check, str] = field(default_factory=dict)
    waived: Mapping[Check, str] = field(default_factory=dict)
    known: Mapping[Check, str] = field(default_factory=dict)  # what else is known of checks of the loop, if they fail

    @property
    def words(self) -> Mapping[Check, str]:
        """For every check of which more is known than that it fails."""
        return {**self.known, **self.failing}

    @property
    def host_checks(self) -> Check:
        """Bits for the loop: CALIBRATION it is told otherwise, and the drive's stop it knows."""
        bits = Check(0)
        for check in self.failing:
            bits |= check & HOST_CHECKS
        return bits


@dataclass(frozen=True)
class Folder:
    """Where the rig writes: the folder asked for, what is free there (None: unknown), whether we may write there."""

    path: pathlib.Path
    free_mib: int | None
    writable: bool = True


def judge(
    settings: RigSettings,
    standing: Standing,
    active: Mapping[str, Any],
    control: Mapping[str, Any],
    folders: Sequence[Folder],
    now: datetime,
) -> Verdict:
    """Every check, from what was read.

    ``active`` and ``control`` are the daemon's files of these names; what is not in them is not known, and fails.
    """
    calibration = settings.calibration
    waiver = calibration.waiver if calibration is not None else None
    realtime = _realtime(control)
    found = (
        (Check.CALIBRATION, _calibration(settings, standing, now), waiver),
        (Check.TARE, _tare(settings, standing, now), waiver),
        (Check.MARGINS, _margins(active), _design_waiver(active)),
        (Check.REALTIME, realtime, settings.loop.realtime_waiver),
        (Check.DISK, _disk(settings, folders), None),
        (Check.DRIVE_SUPERVISION, _supervision(control), None),
    )
    failing = {check: why for check, why, words in found if why and not words}
    return Verdict(failing, {check: " ".join(words.split()) for check, why, words in found if why and words})


def folders(settings: RigSettings) -> list[Folder]:
    """Every folder the rig file has something written to: each disk once, and each folder that we may not write to."""
    ledger = settings.ledger
    places = [*([ledger.parent] if ledger else []), settings.audit_log.parent, settings.file(settings.audit.trips)]
    found: dict[int, Folder] = {}
    for place in places:
        there = next((path for path in (place, *place.parents) if path.is_dir()), pathlib.Path("/"))
        try:
            free = os.statvfs(there)
            writable = os.access(there, os.W_OK | os.X_OK, effective_ids=True)
            disk = there.stat().st_dev if writable else -len(found) - 1
            found.setdefault(disk, Folder(place, free.f_bavail * free.f_frsize // MIB, writable))
        except OSError:
            found.setdefault(-len(found) - 1, Folder(place, None))
    return list(found.values())


def _calibration(settings: RigSettings, standing: Standing, now: datetime) -> str:
    if settings.calibration is None:
        return ""
    if standing.due is None:
        return "no calibration check has passed: rigctl calibrate (or calibration.waiver)"
    if standing.overdue or moment(standing.due) <= now:
        return f"calibration was due on {standing.due[:10]}: rigctl calibrate (or calibration.waiver)"
    return ""


def _tare(settings: RigSettings, standing: Standing, now: datetime) -> str:
    section = settings.calibration
    if section is None:
        return ""
    if standing.tared is None:
        return "no tare on record: rigctl tare with the rope unloaded (or calibration.waiver)"
    done = moment(standing.tared)
    if done + timedelta(days=section.tare_days) <= now or done > now + CLOCKS_DIFFER:
        return f"the last tare is of {standing.tared[:10]}, one holds for {section.tare_days} days: rigctl tare"
    return ""


def _margins(active: Mapping[str, Any]) -> str:
    design = active.get("design")
    if not isinstance(design, dict) or not isinstance(design.get("accepted"), bool):
        return "margins of the law in use are not known: start the daemon anew"
    if not design["accepted"]:
        return f"{design.get('verdict', 'the design is refused')}: rigctl tune"
    return str(design.get("verdict", "margins beyond the limit")) if design.get("waiver") else ""


def _design_waiver(active: Mapping[str, Any]) -> str | None:
    design = active.get("design")
    accepted = isinstance(design, dict) and design.get("accepted") is True
    return str(design["waiver"]) if accepted and isinstance(design, dict) and design.get("waiver") else None


def _realtime(control: Mapping[str, Any]) -> str:
    applied = control.get("realtime")
    if not isinstance(applied, list):
        return "what the system granted the loop is not known yet: try again in a second"
    refused = [str(item.get("warning") or item.get("name")) for item in applied if not item.get("ok")]
    return f"{'; '.join(refused)} (or loop.realtime_waiver)" if refused else ""


def _disk(settings: RigSettings, found: Sequence[Folder]) -> str:
    least = settings.preflight.disk_free_mib
    short = [
        f"{place.path} has {place.free_mib} MiB free" if place.free_mib is not None else f"{place.path} is not there"
        for place in found
        if place.free_mib is None or place.free_mib < least
    ]
    closed = [str(place.path) for place in found if not place.writable]
    user = f"the user of this process (uid {os.geteuid()})"
    return "; ".join([
        *([f"{'; '.join(short)}: make room, preflight.disk_free_mib asks for {least}"] if short else []),
        *([f"{', '.join(closed)}: {user} may not write there: give it the right, or run as another"] if closed else []),
    ])  # fmt: skip


def _supervision(control: Mapping[str, Any]) -> str:
    """Which of the drive's own stop settings is not what was written, as start-up read them back."""
    listed = control.get("supervision")
    wrong = [item for item in listed if not item.get("ok")] if isinstance(listed, list) else []
    words = [
        f"{item['object']} ({item['name']}) found {'nothing' if item['found'] is None else item['found']}, "
        f"wanted {item['wanted']}" + (f", {item['why']}" if item.get("why") else "")
        for item in wrong
    ]
    return f"drive does not enforce its own stop: {'; '.join(words)}: set it in the drive" if words else ""


class Preflight:
    """Looks by itself, and keeps the newest verdict."""

    def __init__(
        self,
        runtime: Runtime,
        settings: RigSettings,
        standing: Callable[[], Standing],
        told: Callable[[], Mapping[Check, str]] = dict,
    ) -> None:
        """``standing``: what the ledger says now. ``told``: what the loop has said of its own checks."""
        self._told = told
        self._runtime, self._settings, self._standing = runtime, settings, standing
        self._newest: tuple[int, Verdict] | None = None
        self._first, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._serve, name="preflight", daemon=True)
        self._thread.start()
        self._first.wait(FIRST_LOOK_S)

    def close(self) -> None:
        """Look no more."""
        self._stop.set()

    def verdict(self, now_ns: int) -> Verdict:
        """The newest, as of ``now_ns`` (CLOCK_MONOTONIC); one that says nothing but `Check.HOST` where that is old."""
        if self._newest is None or now_ns - self._newest[0] > STALE_NS:
            return Verdict({Check.HOST: "tare, margins, real time and disk cannot be looked at: does a disk hang?"})
        return replace(self._newest[1], known=self._told())

    def _serve(self) -> None:
        while not self._stop.is_set():
            began_ns = time.monotonic_ns()
            found = look(self._runtime, self._settings, self._standing(), datetime.now(UTC))
            self._newest = began_ns, found
            self._first.set()
            self._stop.wait(LOOK_AGAIN_S if found.failing else LOOK_S)


def look(runtime: Runtime, settings: RigSettings, standing: Standing, now: datetime) -> Verdict:
    """Read what there is to read, and judge it."""
    read: dict[str, dict[str, Any]] = {ACTIVE: {}, CONTROL: {}}
    for name in read:
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            read[name] = runtime.read_json(name)
    return judge(settings, standing, read[ACTIVE], read[CONTROL], folders(settings), now)
