"""``rigctl check FILE``: the resolved rig, and the worst-case load of its bus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from rigctl.cli.probe_check import ProbeCheck
from rigctl.config.bounds import Stop, findings
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings
from rigctl.config.telemetry_section import open_listen
from rigctl.control.load import held_tension, take_up
from rigctl.control.watch import limits, safety
from rigctl.design.verdict import Design
from rigctl.devices import busload
from rigctl.model.faults import Fault
from rigctl.model.quantity import count, significant, unit_of
from rigctl.model.signals import WATCHED
from rigctl.model.states import Mode

NARROW = 72
"""Columns below which meaning and unit are left out, so that the values fit; the key ends in its unit."""
NARROWEST_VALUE = 8
NARROWEST_FRAME = 11  # for "inclination" and "heartbeats,"
_OF_CANOPEN = ("node", "eds")  # keys that do not apply to a device with plain frames


def as_dict(settings: RigSettings) -> dict[str, Any]:
    """Resolved rig and bus load, for JSON."""
    load, stop = busload.bus_load(settings), Stop.of(settings)
    return {
        "rig": settings.model_dump(mode="json", exclude={"directory", "plain"}),
        "bus_load_pct": None if load is None else round(load * 100, 2),
        "bus_load_limit_pct": busload.LIMIT * 100,
        "accepted": accepted(settings),
        "stop_distance_mm": round(stop.distance_mm, 3),
        "stop_n": round(stop.newtons, 2),
        "held_growing_mm": round(held_tension.stretch_limit_mm(settings, held_tension.GROWS_MM), 3),
        "held_stretch_mm": round(held_tension.stretch_limit_mm(settings), 3),
        "held_creep_mm_s": round(held_tension.smallest_creep_mm_s(settings), 3),
        "held_fall_n": round(held_tension.fall_limit_n(settings), 3),
        "probe": ProbeCheck.of(settings).as_dict(),
        "waived_bounds": [f"{key}: found {found}, expected {allowed}" for key, found, allowed in findings(settings)],
        "waived_listen": open_listen(settings.telemetry),
    }


def accepted(settings: RigSettings) -> bool:
    """Whether the bus load is within the limit."""
    load = busload.bus_load(settings)
    return load is None or load <= busload.LIMIT


def verdict(settings: RigSettings) -> str:
    """Bus load in one line."""
    load = busload.bus_load(settings)
    if load is None:
        return "bus load: not judged, this bus has no bit rate"
    words = "within" if load <= busload.LIMIT else "REFUSED: above"
    advice = busload.advice(settings) if load > busload.LIMIT else ""
    return (
        f"bus load: {load:.1%} of {settings.can.bitrate_bit_s} bit/s at worst, {words} the limit of {busload.LIMIT:.0%}"
        f"{f'; {advice}' if advice else ''}"
    )


def show(settings: RigSettings, console: Console) -> None:
    """Print the resolved rig, then the frames that load its bus."""
    rig = Table(title=f"rig {settings.rig}", title_justify="left", box=None)
    narrow = console.width < NARROW
    # Keys whole: they are copied into a rig file. Only a narrow terminal breaks them over lines.
    widths = {"max_width": max(NARROWEST_VALUE, console.width - NARROWEST_VALUE - 4)} if narrow else {"no_wrap": True}
    rig.add_column("key", overflow="fold", min_width=None if narrow else _widest_key(settings), **widths)
    rig.add_column("value", overflow="fold", min_width=NARROWEST_VALUE)
    if not narrow:
        rig.add_column("unit", no_wrap=True)
        rig.add_column("meaning", overflow="fold")
    for section in type(settings).model_fields:
        value = getattr(settings, section)
        if section == "plain":
            continue
        if isinstance(value, Settings):
            _add_section(rig, section, value, narrow)
        elif value is None:
            rig.add_row(f"[bold]{section}[/]", "not in the file")
    console.print(rig)
    for device, message in settings.plain_messages.items():
        console.print(
            f"{device}: {message.name}, id 0x{message.can_id:03X}, {count(message.size, 'byte')}, in N and rad",
            highlight=False,
        )
        for signal in message.signals.values():
            console.print(f"  {signal}", highlight=False)
    console.print(_watched(settings))
    console.print(
        "limits may watch: " + ", ".join(f"{name} ({watch.meaning})" for name, watch in WATCHED.items()),
        highlight=False,
    )
    frames = Table(title="bus", title_justify="left", box=None)
    frames.add_column("frame", overflow="fold", min_width=NARROWEST_FRAME)
    for column in ("bytes", "per second", "bit/s at worst"):
        frames.add_column(column)
    for item in busload.traffic(settings):
        frames.add_row(item.name, str(item.size), significant(item.rate_hz), f"{item.bit_s:.0f}")
    console.print(frames)
    console.print(verdict(settings), highlight=False)
    console.print(Stop.of(settings).in_words(settings), highlight=False)
    for line in _protection(settings):
        console.print(line, highlight=False, markup=False)
    if reached := open_listen(settings.telemetry):
        console.print(f"WAIVED ({settings.telemetry.listen_waiver}): {reached}", highlight=False, markup=False)


def _widest_key(settings: Settings, indent: int = 2) -> int:
    """Columns of the longest key, with its indent; a section in a section is named in full."""
    found = [indent + len(key) for key in type(settings).model_fields]
    for section in type(settings).model_fields:
        if isinstance(inner := getattr(settings, section), Settings) and section != "plain":
            found.append(_widest_key(inner))
    return max(found)


def show_design(design: Design, console: Console) -> None:
    """Print the verdict on the gains, as `rigctl run` does."""
    words = design.verdict()
    console.print(words if words.startswith("design") else f"design: {words}", highlight=False, markup=False)
    for warning in design.warnings():
        console.print(f"WARNING: design: {warning}", highlight=False, markup=False)


def last_resort(settings: RigSettings) -> str:
    """What follows a command that shows no effect."""
    cylinder, io = settings.cylinder, settings.io
    own_ms = max(cylinder.heartbeat_timeout_ms, cylinder.command_deadline_ms)
    words = (
        f"last resort: power off by SDO, NMT stop, then silence: the drive's own supervision stops it in {own_ms} ms"
    )
    if io is None or io.drive_enable_output is None:
        return (
            f"{words}. No hard-wired enable (io.drive_enable_output): only the emergency stop stops a drive that "
            "reacts to neither"
        )
    return (
        f"{words}; output {io.drive_enable_output} of the I/O node takes the motor's torque away (STO), shown by its "
        f"input {io.drive_off_input}"
    )


def _protection(settings: RigSettings) -> Iterator[str]:
    """What a rig without a brake, a held load and the probe are exposed to, and the bounds that are waived."""
    if settings.cylinder.brake_waiver is not None:
        yield f"WAIVED ({settings.cylinder.brake_waiver}): {without_brake(settings)}"
    yield last_resort(settings)
    yield held_tension.in_words(settings)
    yield take_up.in_words(settings)
    yield from ProbeCheck.of(settings).lines()
    for key, found, allowed in findings(settings):
        yield f"WAIVED ({settings.safety.waiver}): {key}: found {found}, expected {allowed}"


def without_brake(settings: RigSettings) -> str:
    """The creep that a rig without a brake is exposed to, as its motor holds for as long as HOLD lasts."""
    stretch_mm = held_tension.stretch_limit_mm(settings)
    stretch_n = stretch_mm * settings.plant.stiffness_n_mm
    return (
        "no holding brake: HOLD and FAULT last under power. A drive that creeps while its encoder shows no motion is "
        f"found by the tension after {stretch_mm:.2g} mm ({stretch_n:.3g} N); with a silent cell nothing shows it"
    )


def _watched(settings: RigSettings) -> Table:
    """The safety table: the built-in rows, then the rig file's limits."""
    table = Table(title="watched (modes by their first letters)", title_justify="left", box=None)
    table.add_column("what", overflow="fold")
    for column in ("beyond", "for ms", "action"):
        table.add_column(column, overflow="fold")
    table.add_column("modes", min_width=len(Mode))
    for row in (*safety.table(settings), *limits.rows(settings)):
        nanoseconds = row.unit == "ns"
        limit = row.sign * row.limit * (1e-6 if nanoseconds else 1.0)
        beyond = significant(limit, "ms" if nanoseconds else row.unit) if limit or row.unit else "-"
        modes = "".join(mode.name[0] if mode in row.modes else "." for mode in Mode)
        action = row.action.name.lower().replace("_", " ")
        what = row.text if row.fault is Fault.LIMIT else f"{row.fault.name} {row.text}".strip()
        table.add_row(what, beyond, f"{row.persistence_ns // 1_000_000}", action, modes)
    return table


def _add_section(table: Table, section: str, settings: Settings, narrow: bool) -> None:
    table.add_row(f"[bold]{section}[/]")
    unused = _OF_CANOPEN if getattr(settings, "dbc", None) else ()
    for key, info in type(settings).model_fields.items():
        if key in unused:
            continue
        found = getattr(settings, key)
        if isinstance(found, Settings):
            _add_section(table, f"  {section}.{key}", found, narrow)
            continue
        text = "-" if found is None else significant(found) if isinstance(found, float) else str(found)
        table.add_row(f"  {key}", text, *(() if narrow else (unit_of(key), info.description or "")))
