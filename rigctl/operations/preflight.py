"""The host checks, the part of the preflight the loop cannot make itself: files, margins, real time, disk space.

The loop gets the result when it changes and before every ARM (`rigctl.model.verbs.Setting.HOST_CHECKS`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger, wall_clock
from rigctl.ipc.ledger import Standing, moment
from rigctl.ipc.written_folders import Folder
from rigctl.model.checks import HOST_CHECKS, Check


@dataclass(frozen=True)
class PreflightVerdict:
    """Failing checks with the words for the operator, and waived checks with the waiver's words."""

    failing: Mapping[Check, str] = field(default_factory=dict)
    waived: Mapping[Check, str] = field(default_factory=dict)
    known: Mapping[Check, str] = field(default_factory=dict)  # details of the loop's own checks, if they fail

    @property
    def words(self) -> Mapping[Check, str]:
        """Details by check, for those that have any."""
        return {**self.known, **self.failing}

    @property
    def host_checks(self) -> Check:
        """Bits for the loop; without CALIBRATION, which has its own setting, and the drive's stop, which it knows."""
        bits = Check(0)
        for check in self.failing:
            bits |= check & HOST_CHECKS
        return bits


def judge(
    settings: RigSettings,
    standing: Standing,
    active: Mapping[str, Any],
    control: Mapping[str, Any],
    folders: Sequence[Folder],
    now: datetime,
) -> PreflightVerdict:
    """Judge every check.

    ``active`` and ``control`` are the daemon's files of these names; a check fails if its values are missing there.
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
    return PreflightVerdict(failing, {check: " ".join(words.split()) for check, why, words in found if why and words})


def _calibration(settings: RigSettings, standing: Standing, now: datetime) -> str:
    if settings.calibration is None:
        return ""
    if standing.due is None:
        return "no calibration check has passed: rigctl calibrate (or calibration.waiver)"
    if ledger.is_overdue(settings, standing.due, now):
        return f"calibration was due on {standing.due[:10]}: rigctl calibrate (or calibration.waiver)"
    return ""


def _tare(settings: RigSettings, standing: Standing, now: datetime) -> str:
    section = settings.calibration
    if section is None:
        return ""
    if standing.tared is None:
        return "no tare on record: rigctl tare with the rope unloaded (or calibration.waiver)"
    age = wall_clock.age(moment(standing.tared), now)
    if age is not None and age >= timedelta(days=section.tare_days):
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
    """The drive's own stop settings that start-up did not read back as written, in words; empty if all are right."""
    listed = control.get("supervision")
    wrong = [item for item in listed if not item.get("ok")] if isinstance(listed, list) else []
    words = [
        f"{item['object']} ({item['name']}) found {'nothing' if item['found'] is None else item['found']}, "
        f"wanted {item['wanted']}" + (f", {item['why']}" if item.get("why") else "")
        for item in wrong
    ]
    return f"drive does not enforce its own stop: {'; '.join(words)}: set it in the drive" if words else ""
