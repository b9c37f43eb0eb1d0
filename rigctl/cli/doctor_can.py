"""Findings of ``rigctl doctor`` on the CAN link, from `ip -details -json link`."""

from __future__ import annotations

import errno
import json
import socket
import subprocess
from typing import Any

from rigctl.cli.doctor_host import DoctorFinding, fails, good, warning
from rigctl.config.can_section import CanSettings

LIMIT_S = 5.0
QUEUE = 10
"""Frames, the kernel's default: five ticks of SYNC and command. A longer queue would deliver stale commands to the
drive; a send to a full queue is counted and reported at once, and the drive's own deadline stops it."""
STATES = ("ERROR-ACTIVE", "ERROR-WARNING")


def link(can: CanSettings) -> list[DoctorFinding]:
    """Findings on the link of the rig file."""
    if can.interface != "socketcan":
        return [_without_kernel(can)]
    command = ["ip", "-details", "-json", "link", "show", "dev", can.channel]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return [warning("can link", f"ip cannot be asked: {error}", "ip of iproute2", "install iproute2")]
    return judge(can, answer.stdout) if answer.returncode == 0 else [_missing(can)]


def judge(can: CanSettings, shown: str) -> list[DoctorFinding]:
    """Findings from the output of `ip`."""
    try:
        found: dict[str, Any] = json.loads(shown)[0]
    except (ValueError, IndexError, KeyError, TypeError):
        return [_missing(can)]
    about = found.get("linkinfo", {})
    kind, data = about.get("info_kind"), about.get("info_data", {})
    if found.get("link_type") != "can":
        return [fails("can link", f"{can.channel} is no CAN interface", "one", "check can.channel")]
    up = "UP" in found.get("flags", [])
    findings = [good("can link", f"{can.channel} is up") if up else _down(can)]
    if kind == "vcan":
        findings.append(warning("can bit rate", "a virtual interface has none", "a real one"))
    else:
        findings += [_bit_rate(can, data), *_state(can, data, up=up), _restart(can, data)]
        findings.append(_counters(about.get("info_xstats", {})))
    findings.append(_queue(can, found.get("txqlen", 0)))
    return findings


def _without_kernel(can: CanSettings) -> DoctorFinding:
    if can.interface != "rigsim":
        from rigctl.devices import can_interface  # python-can takes 0.2 s to import

        where = f"{can.interface}:{can.channel}"
        if why := can_interface.lacking(can):
            return fails("can link", f"{where} cannot be opened here: {why}", "an interface complete", "install it")
        return good("can link", f"no kernel CAN: {where}")
    if _is_served(can.channel):
        return good("can link", f"no kernel CAN: simulated rig at {can.channel}")
    return warning("can link", f"no kernel CAN, and no simulated rig at {can.channel}", "one", "python -m hil serve")


def _is_served(path: str) -> bool:
    """Whether a simulated rig takes connections there: the file alone outlives a rig that was killed."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.setblocking(False)
        return client.connect_ex(path) in (0, errno.EAGAIN)  # EAGAIN: many others wait to be taken


def _missing(can: CanSettings) -> DoctorFinding:
    return fails("can link", f"no interface {can.channel}", "one", "plug in the adapter, load its driver (ip link)")


def _down(can: CanSettings) -> DoctorFinding:
    return fails("can link", f"{can.channel} is down", "up", f"ip link set {can.channel} up")


def _bit_rate(can: CanSettings, data: dict[str, Any]) -> DoctorFinding:
    rate = data.get("bittiming", {}).get("bitrate") or data.get("bittiming_bitrate")
    wanted = f"{can.bitrate_bit_s} bit/s"
    if not rate:
        return warning("can bit rate", "not shown by the driver", wanted)
    if rate == can.bitrate_bit_s:
        return good("can bit rate", wanted)
    channel = can.channel
    fix = f"ip link set {channel} down; ip link set {channel} up type can bitrate {can.bitrate_bit_s}"
    return fails("can bit rate", f"{rate} bit/s", wanted, fix)


def _state(can: CanSettings, data: dict[str, Any], *, up: bool) -> list[DoctorFinding]:
    state, errors = data.get("state"), data.get("berr_counter") or {}
    if state is None or not up:
        return []
    found = f"{state}, errors sent {errors.get('tx', '?')}, received {errors.get('rx', '?')}"
    if state == STATES[0]:
        return [good("can state", found)]
    if state in STATES:
        return [warning("can state", found, STATES[0], "check cable, termination and bit rate")]
    again = f"check cable, termination and bit rate; then ip link set {can.channel} down, and up"
    return [fails("can state", found, STATES[0], again)]


def _restart(can: CanSettings, data: dict[str, Any]) -> DoctorFinding:
    """The automatic restart: a bus must not resume by itself after a fault that no one has examined."""
    restart = data.get("restart_ms")
    if not restart:
        return good("can restart-ms", "0: after a bus-off an operator decides")
    fix = f"ip link set {can.channel} down; ip link set {can.channel} up type can restart-ms 0"
    return warning("can restart-ms", f"{restart}", "0, so that after a bus-off an operator decides", fix)


def _counters(counted: dict[str, Any]) -> DoctorFinding:
    names = ("bus_error", "error_warning", "error_passive", "bus_off", "restarts", "arbitration_lost")
    figures = {name: int(counted.get(name, 0)) for name in names}
    found = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in figures.items())
    bad = [name for name in names[:-1] if figures[name]]
    if not bad:
        return good("can counters", found)
    return warning("can counters", found, "0 since the link came up", "check cable, termination and bit rate")


def _queue(can: CanSettings, length: int) -> DoctorFinding:
    if length == QUEUE:
        return good("can queue", f"txqueuelen {length}")
    wanted = f"{QUEUE}: frames that wait in a longer one reach the drive late"
    return warning("can queue", f"txqueuelen {length}", wanted, f"ip link set {can.channel} txqueuelen {QUEUE}")
