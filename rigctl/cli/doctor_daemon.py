"""Findings of ``rigctl doctor`` on the rig: the daemon's preflight, or the part of it that needs no daemon."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from rigctl import __version__
from rigctl.cli.doctor_host import DoctorFinding, fails, good, warning
from rigctl.config.settings import LoopSettings, RigSettings
from rigctl.ipc import ledger, written_folders
from rigctl.model.checks import Check
from rigctl.operations import preflight

TRY_S = 20.0
TITLES: dict[Check, str] = {
    Check.CELL_STALE: "cell: fresh samples",
    Check.CELL_INVALID: "cell: valid, not overloaded",
    Check.CELL_IMPLAUSIBLE: "cell: plausible",
    Check.SECOND_FORCE: "second force path: comes, has a zero",
    Check.FORCES_DISAGREE: "second force path: agrees with the cell",
    Check.INCLINATION_STALE: "inclination: fresh samples",
    Check.INCLINATION_INVALID: "inclination: valid",
    Check.DRIVE_STALE: "drive: fresh samples",
    Check.STATUS_STALE: "drive: current, temperature and inputs come",
    Check.DRIVE_FAULT: "drive: no fault",
    Check.DRIVE_REFUSES: "drive: ours to command",
    Check.DRIVE_SUPERVISION: "devices: keep what start-up wrote",
    Check.NODE_NOT_OPERATIONAL: "devices: heartbeats come, operational",
    Check.SEQUENCE_RUNNING: "drive: off, brake closed",
    Check.NOT_AT_STANDSTILL: "stroke: stands still",
    Check.EMERGENCY: "devices: no emergency",
    Check.RIVAL: "bus: no other controller",
    Check.E_STOP: "emergency stop: released",
    Check.E_STOP_UNSEEN: "emergency stop: seen",
    Check.E_STOP_IO: "emergency stop, I/O node: released",
    Check.E_STOP_IO_UNSEEN: "emergency stop, I/O node: seen",
    Check.ENABLE_IGNORED: "drive: STO feedback follows its hard-wired enable",
    Check.TENSION_HIGH: "tension: below its limit",
    Check.STROKE_RANGE: "stroke: within its limits",
    Check.STROKE_NEAR_END: "stroke: away from its ends",
    Check.STROKE_UNCONFIRMED: "stroke: the one last known",
    Check.LIMIT: "limits of the rig file: kept",
    Check.CALIBRATION: "calibration: in force",
    Check.TARE: "tare: in force",
    Check.MARGINS: "margins: accepted",
    Check.REALTIME: "real time: granted",
    Check.DISK: "disk: room to write",
    Check.HOST: "host: looked at by the gateway",
}
"""Every check, in the order of display."""
_OF_FITTED = {
    "io": Check.E_STOP_IO | Check.E_STOP_IO_UNSEEN,
    "io.drive_enable_output": Check.ENABLE_IGNORED,
    "second_force": Check.SECOND_FORCE | Check.FORCES_DISAGREE,
}
"""Checks of a section, or of a key in it, that not every rig file has."""
_SEEN_BY: dict[Check, Check] = {
    **dict.fromkeys(
        (Check.CELL_INVALID, Check.CELL_IMPLAUSIBLE, Check.TENSION_HIGH), Check.CELL_STALE
    ),
    Check.FORCES_DISAGREE: Check.SECOND_FORCE,
    Check.INCLINATION_INVALID: Check.INCLINATION_STALE,
    **dict.fromkeys(
        (
            Check.DRIVE_FAULT, Check.DRIVE_REFUSES, Check.SEQUENCE_RUNNING, Check.NOT_AT_STANDSTILL, Check.STROKE_RANGE,
            Check.STROKE_NEAR_END, Check.STROKE_UNCONFIRMED,
        ), Check.DRIVE_STALE,
    ),
    Check.DRIVE_SUPERVISION: Check.NODE_NOT_OPERATIONAL,
    Check.EMERGENCY: Check.NODE_NOT_OPERATIONAL,
    Check.E_STOP: Check.E_STOP_UNSEEN,
    Check.E_STOP_IO: Check.E_STOP_IO_UNSEEN,
    Check.ENABLE_IGNORED: Check.E_STOP_IO_UNSEEN,
}  # fmt: skip
"""By a check: the one whose failure leaves it without anything seen, so that it is not known."""
WITHOUT_DAEMON = (Check.CALIBRATION, Check.TARE, Check.DISK, Check.MARGINS)


def running(state: Mapping[str, Any], active: Mapping[str, Any], settings: RigSettings | None) -> list[DoctorFinding]:
    """The preflight of a running daemon, from its state; ``settings``: those of the rig file, if one is given."""
    findings = [_loop(state), _version(active), _same_file(active, settings)]
    shown = state.get("preflight")
    if not isinstance(shown, dict):
        return [*findings, fails("preflight", "the daemon says nothing of it", "a verdict", "start the daemon anew")]
    failing, waived = shown.get("failing", {}), shown.get("waived", {})
    findings.append(_read_back(state))
    settings_now = active.get("settings") or {}
    left_out = Check(0)
    for path, checks in _OF_FITTED.items():
        section, _, key = path.partition(".")
        found = settings_now.get(section)
        found = found.get(key) if key and isinstance(found, dict) else found
        left_out |= checks if found is None else Check(0)
    return findings + [_check(check, failing, waived) for check in TITLES if not check & left_out]


def without(settings: RigSettings) -> list[DoctorFinding]:
    """The part of the preflight that needs no daemon, and the real time that the system would grant its loop."""
    try:
        entries = ledger.read(settings)
    except ledger.LedgerError as error:
        return [fails("calibration: in force", str(error), "a ledger"), *_realtime(settings.loop)]
    standing = ledger.standing(settings, entries, time.time_ns())
    active = {"design": _design(settings)}
    found = preflight.judge(settings, standing, active, {}, written_folders.folders(settings), datetime.now(UTC))
    failing = {check.name: why for check, why in found.failing.items()}
    waived = {check.name: words for check, words in found.waived.items()}
    return [*(_check(check, failing, waived) for check in WITHOUT_DAEMON), *_realtime(settings.loop)]


def _check(check: Check, failing: Mapping[str | None, str], waived: Mapping[str | None, str]) -> DoctorFinding:
    title = TITLES[check]
    if why := failing.get(check.name):
        found, _, fix = why.partition(": ")
        return fails(title, found, title.partition(": ")[2], fix)
    if words := waived.get(check.name):
        return warning(title, f"not so, waived: {words}", title.partition(": ")[2])
    by = _SEEN_BY.get(check)
    if by is not None and by.name in failing:
        return warning(title, f"not known: {failing[by.name].partition(': ')[0]}", title.partition(": ")[2])
    return good(title, "yes")


def _loop(state: Mapping[str, Any]) -> DoctorFinding:
    if not state.get("loop_alive"):
        return fails("loop", "no fresh record", "running", "see the daemon's log")
    late = state.get("lateness_us") or {}
    return good("loop", f"running, {state.get('mode')}, lateness p99.9 {late.get('p999', '?')} us")


def _read_back(state: Mapping[str, Any]) -> DoctorFinding:
    """The devices' safety settings at the loop's last complete read-back."""
    title, shown, now_ns = "devices: settings read back", state.get("read_back"), state.get("t_ns")
    if not isinstance(shown, dict) or not isinstance(now_ns, int):
        return good(title, "at the start; again at every arm")
    ago_s = (now_ns - shown["t_ns"]) / 1e9
    return good(title, f"{shown['settings']} in {shown['took_s']:.2f} s, {ago_s:.0f} s ago")


def _version(active: Mapping[str, Any]) -> DoctorFinding:
    found = str(active.get("version", "unknown"))
    if found == __version__:
        return good("daemon", f"rigctl {found}")
    return warning("daemon", f"rigctl {found}", f"rigctl {__version__}, as this command", "start the daemon anew")


def _same_file(active: Mapping[str, Any], settings: RigSettings | None) -> DoctorFinding:
    if settings is None:
        return good("rig file", "as the daemon read it")
    now = settings.model_dump(mode="json")
    then = active.get("settings") or {}
    changed = sorted(name for name in now if name != "directory" and now[name] != then.get(name))
    if not changed:
        return good("rig file", "the one that runs")
    return warning("rig file", f"differs from what runs in {', '.join(changed)}", "the same", "start the daemon anew")


def _design(settings: RigSettings) -> dict[str, Any]:
    from rigctl.design.gains import DesignError
    from rigctl.design.in_use import design_in_use  # slow import (python-control)

    try:
        return design_in_use(settings).as_dict()
    except (DesignError, ArithmeticError, ValueError) as error:
        return {"accepted": False, "waiver": None, "verdict": f"no design: {error}"}


def _realtime(loop: LoopSettings) -> list[DoctorFinding]:
    """The real time that the system grants, tried in another process so that this one stays as it is."""
    command = [sys.executable, "-m", "rigctl.cli.doctor_try"]
    try:
        text = loop.model_dump_json()
        tried = subprocess.run(command, input=text, capture_output=True, text=True, timeout=TRY_S, check=True)
        applied = json.loads(tried.stdout)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        return [warning("real time: granted", f"cannot be tried: {error}", "granted")]
    return [_granted(item, loop.realtime_waiver) for item in applied]


def _granted(item: Mapping[str, Any], waiver: str | None) -> DoctorFinding:
    name = f"real time: {item['name']}"
    if item["ok"]:
        return good(name, item["in_force"])
    found, _, fix = item["warning"].partition(": ")
    if waiver:
        return warning(name, f"{found}, waived: {waiver}", item["asked"], fix)
    return fails(name, found, item["asked"], fix)
