"""States of a rig as its gateway publishes them, for every mode, fault and lost device; and a page that shows one."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import uvicorn

from rigctl.config.address import Address
from rigctl.ipc.record import RECORD
from rigctl.model.checks import Check
from rigctl.model.events import Kind, worded
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault, bits_of
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode, PowerOff
from rigctl.page.guard import Guard
from rigctl.page.page_commands import PageCommands
from rigctl.page.picture import Picture
from rigctl.page.server import Page
from rigctl.wire.record_names import quality_words
from tests.builders.offered import offered
from tests.builders.waiting import until

S = 1_000_000_000
LOCK_OUT = "Q1 (24 V stays on)"
ACTIVE: dict[str, Any] = {
    "settings": {
        "rig": "paper_rig",
        "safety": {"tension_high_n": 400.0, "tension_low_n": 20.0, "lock_out": LOCK_OUT},
        "tension": {"target_min_n": 50.0, "target_max_n": 350.0},
        "cylinder": {"stroke_min_mm": -20.0, "stroke_max_mm": 120.0, "e_stop_input": 0},
        "loop": {"rate_hz": 1000},
        "limits": [
            {"signal": "vertical_error_n", "high": 15.0, "action": "hold"},
            {"signal": "stroke_mm", "low": -17.0, "high": 117.0, "action": "log"},
        ],
    },
    "bus_load": 0.45,
}
LOST = (frozenset[str](), frozenset({"tension"}), frozenset({"drive"}), frozenset({"inclination"}),
        frozenset({"tension", "drive", "inclination"}))  # fmt: skip
"""Devices of which nothing valid comes."""
_LOST_WITH = {
    Fault.CELL_STALE: {"tension"}, Fault.CELL_INVALID: {"tension"}, Fault.DRIVE_STALE: {"drive"},
    Fault.INCLINATION_STALE: {"inclination"}, Fault.INCLINATION_INVALID: {"inclination"},
    Fault.BUS_SILENT: {"tension", "drive", "inclination"}, Fault.SYNC_LOST: {"tension", "drive", "inclination"},
}  # fmt: skip
FOLLOWING = (
    Fault.SUPERVISION_LOST, Fault.DRIVE_STALE, Fault.CELL_STALE, Fault.INCLINATION_STALE, Fault.STATUS_STALE,
    Fault.NODE_NOT_OPERATIONAL, Fault.E_STOP_UNSEEN, Fault.LIMIT,
)  # fmt: skip
"""Causes that come with a silent bus."""


@dataclass
class Shown:
    """A state, and the events that led to it."""

    name: str
    state: dict[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)


def event(kind: Kind, at_s: float, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, about: str = "",
          ) -> dict[str, Any]:  # fmt: skip
    """An event as the gateway words it, ``at_s`` before or after now."""
    words, wall_ns = worded(kind, a, b, value, limit, about), time.time_ns() + round(at_s * S)
    return {
        "source": "loop", "kind": kind.name, "a": a, "b": b, "value": value, "limit": limit, "about": about,
        "text": words.text, "severity": words.severity, "wall_ns": wall_ns, "t_ns": wall_ns, "seq": wall_ns,
    }  # fmt: skip


ABOUT = {Fault.LIMIT: "tension_rate_n_s above", Fault.DRIVE_NOT_FOLLOWING: "speed"}
"""What the text of an event says beside its figures."""


def figures_of(fault: Fault) -> tuple[float, float]:
    """A value and a limit as a fault may have them."""
    if fault is Fault.TENSION_HIGH:
        return 450.1, 400.0
    return (12e6, 5e6) if "ms" in fault.words else (38.4, 10.0)


def cause_of(fault: Fault, at_s: float = -7.0) -> dict[str, Any]:
    """An active cause of a state message."""
    value, limit = figures_of(fault)
    about = ABOUT.get(fault, "")
    return {
        "fault": fault.name, "text": fault_text(fault, value, limit, about), "action": Action.HOLD.name,
        "value": value, "limit": limit, "since_ns": 1, "since_wall_ns": time.time_ns() + round(at_s * S),
        "blocks_reset": fault.blocks_reset,
    }  # fmt: skip


def state(
    mode: Mode, *, fault: Fault = Fault.NONE, active: bool = True, lost: frozenset[str] = frozenset(),
    held_by: HeldBy | None = None, **more: Any,
) -> dict[str, Any]:  # fmt: skip
    """A state message in a mode, with a fault that is active or cleared and latched, without the ``lost`` devices."""
    lost = lost | (_LOST_WITH.get(fault, set()) if active else set())
    moves = mode in (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
    by = held_by if held_by is not None else HeldBy.NOTHING if moves else HeldBy.BRAKE
    on = by in (HeldBy.MOTOR, HeldBy.NOTHING)
    if "drive" in lost:
        by = HeldBy.UNKNOWN
    causes = [cause_of(fault)] if fault and active else []
    text = cause_of(fault)["text"] if fault else ""
    if fault is Fault.BUS_SILENT and active:
        causes += [cause_of(other) for other in FOLLOWING]
    quality = {name: quality_words(1 if name in lost else 0) for name in ("tension", "inclination", "drive")}
    compensating = mode is Mode.COMPENSATING
    made = {
        "rig": "paper_rig", "mode": mode.name, "loop_alive": True, "age_ms": 1.0, "wall_ns": time.time_ns(),
        "flag_names": ["drive_enabled"] if on else [], "fault": fault.name if fault else None,
        "fault_code": int(fault), "fault_text": text,
        "causes": causes, "held_by": by.name, "held_by_code": int(by), "power_off": None,
        **drive_reports(by),
        "load_at_rest": _at_rest(moves=moves, lost=lost, fault=fault), "checks": 0,
        "preflight": {"failing": {}, "waived": {"CALIBRATION": "simulated cell: there is no weight to hang on it"}},
        "quality": quality, "vertical_n": 300.04, "tension_n": 300.06, "target_n": 300.0, "setpoint_n": 300.06,
        "error_n": 0.04 if compensating else None, "error_pct": 0.013 if compensating else None, "stroke_mm": 52.3,
        "speed_mm_s": 0.06 if on else 0.0, "tangential_deg": 0.02, "normal_deg": -0.06, "tick": 9000,
        "skipped": 0, "move": 0,
        **{f"{name}_age_ns": 8_500_000_000 if name in lost else 1_000_000 for name in quality},
        "drive_current_a": 0.72 if on else 0.0, "drive_temperature_c": 25.0, "frames_lost": 0, "frames_refused": 0,
        "send_failures": 0, "error_frames": 0, "lateness_us": None, "work_us": None, "design": "Ms 1.2",
        "sink_mm_s": None, "slack_s": None, "end_s": None,
        "calibration": {"zero_n": 0.1, "scale": 1.0, "overdue": True, "waiver": "simulated cell: no weight to hang"},
        "lease": {"holder": "kim", "held_s": 31.0, "left_s": 260.0}, "audit": {"entries": 9, "failures": 0},
        "recording": None, "trip_dump": None, "warnings": ["SCHED_FIFO 80 refused: not permitted"],
        "gateway_wall_ns": 1, **more,
    }  # fmt: skip
    return {"offers": offered(made), **made}


def _at_rest(*, moves: bool, lost: frozenset[str], fault: Fault) -> str:
    """What shows the load at rest, of the devices that are heard and not in doubt."""
    if moves:
        return "MOVES"
    tension = "tension" not in lost and fault is not Fault.CELL_STUCK
    if "drive" in lost:
        return "TENSION" if tension else "UNKNOWN"
    return "BOTH" if tension else "STROKE"


def drive_reports(by: HeldBy) -> dict[str, str | None]:
    """What a drive reports with which ``by`` carries the load."""
    if by is HeldBy.UNKNOWN:
        return {"drive_state": None, "drive_power": None}
    if by is HeldBy.BRAKE:
        return {"drive_state": "SWITCH_ON_DISABLED", "drive_power": "OFF"}
    on = by in (HeldBy.MOTOR, HeldBy.NOTHING)
    return {"drive_state": "OPERATION_ENABLED" if on else "SWITCHED_ON", "drive_power": "NOT_OFF"}


def tripped(fault: Fault, active: bool = True, ago_s: float = 7.0) -> list[dict[str, Any]]:
    """The events of a trip out of COMPENSATING, ``ago_s`` before now."""
    value, limit = figures_of(fault)
    about = ABOUT.get(fault, "")
    found = [
        event(Kind.MODE, -33.0 - ago_s, Mode.TENSIONING, Mode.COMPENSATING, 2.0),
        event(Kind.TRIP, -0.1 - ago_s, fault, Action.HOLD, value, limit, about),
        event(Kind.MODE, -ago_s, Mode.COMPENSATING, Mode.FAULT, 7.0),
    ]
    return found if active else [*found, event(Kind.CAUSE_OVER, -2.0, fault, Action.HOLD, value, limit, about)]


def catalogue() -> Iterator[Shown]:
    """Every mode with every loss of devices; every fault, active and cleared, by motor and brake, with every loss."""
    for mode, lost in itertools.product((mode for mode in Mode if mode is not Mode.FAULT), LOST):
        yield Shown(f"{mode.name} without {sorted(lost)}", state(mode, lost=lost))
    for check in Check:
        failing = {"failing": {check.name: check.words}, "waived": {}}
        yield Shown(f"DISARMED, {check.name}", state(Mode.DISARMED, checks=int(check), preflight=failing))
    faults = [fault for fault in Fault if fault is not Fault.NONE]
    for fault, active, by, lost in itertools.product(faults, (True, False), (HeldBy.MOTOR, HeldBy.BRAKE), LOST):
        name = f"{fault.name} {'active' if active else 'cleared'}, {by.name}, without {sorted(lost)}"
        yield Shown(name, state(Mode.FAULT, fault=fault, active=active, lost=lost, held_by=by), tripped(fault, active))
    off: tuple[Fault, ...] = (Fault.DRIVE_FAULT, Fault.STROKE_MOVES, Fault.E_STOP)
    for unpowered, shown in itertools.product(off, PowerOff):
        more: dict[str, Any] = {"power_off": shown.name} if shown else {}
        name = f"{unpowered.name}, {shown.name}"
        yield Shown(name, state(Mode.FAULT, fault=unpowered, **more), tripped(unpowered))
    yield Shown("STROKE_MOVES, sinking", state(Mode.FAULT, fault=Fault.STROKE_MOVES, sink_mm_s=-0.3, slack_s=160.0),
                tripped(Fault.STROKE_MOVES))  # fmt: skip
    carries: dict[str, Any] = {"held_by": HeldBy.MOTOR, "flag_names": ["drive_enabled", "brake_fails", "carries"]}
    for left_s in (7.2, 0.0):
        yield Shown(f"the daemon is to end, {left_s:g} s", state(Mode.FAULT, fault=Fault.BRAKE_SLIPS, end_s=left_s,
                                                                 **carries), tripped(Fault.BRAKE_SLIPS))  # fmt: skip
    yield Shown("stopping", state(Mode.FAULT, fault=Fault.E_STOP, held_by=HeldBy.CLOSING,
                                  flag_names=["stopping", "drive_enabled"]), tripped(Fault.E_STOP))  # fmt: skip
    yield Shown("lowering", state(Mode.RELEASING, fault=Fault.LIMIT, active=False), tripped(Fault.LIMIT, False))
    culprit = {
        "parts": ["rope or spring", "tension cell"], "text": "the cell reads nothing, and the stroke does not move",
        "question": "does the rope hang loose?", "first": "Keep out from under the load.", "follows": ["LIMIT"],
    }  # fmt: skip
    yield Shown("two candidates", state(Mode.FAULT, fault=Fault.CELL_STUCK, culprit=culprit), tripped(Fault.CELL_STUCK))
    stopped = {"loop_alive": False, "age_ms": 4300.0, "wall_ns": time.time_ns() - 4_300_000_000}
    yield Shown("loop stopped", state(Mode.COMPENSATING) | stopped)
    yield Shown("no record", {"rig": "paper_rig", "mode": None, "loop_alive": False, "age_ms": None, "wall_ns": 1,
                              "fault": None, "warnings": [], "quality": {}})  # fmt: skip
    yield Shown("on the way to 310 N", state(Mode.COMPENSATING, target_n=310.0, error_n=-9.96, error_pct=3.2))


def picture_of(shown: Shown) -> Picture:
    """What the page's server holds in that state."""
    picture = Picture("tcp/127.0.0.1:7447")
    picture.take_active(ACTIVE)
    picture.add_events(shown.events)
    picture.take_state(shown.state)
    return picture


def charted(picture: Picture) -> None:
    """A minute of records that end in the picture's state; a fault began 7 s before its end."""
    assert picture.state is not None
    now = picture.state
    count = 6000
    records = np.zeros(count, RECORD.dtype)
    t_s = np.arange(count) * 0.01
    records["t_ns"] = np.arange(count) * 10_000_000
    records["tick"], records["mode"] = np.arange(count) * 10, int(Mode[now["mode"]])
    records["vertical_n"] = records["tension_n"] = 300.0 + 0.2 * np.sin(t_s)
    records["setpoint_n"] = records["target_n"] = 300.0
    records["stroke_mm"], records["speed_mm_s"] = 52.3 + np.sin(t_s), np.cos(t_s)
    records["tangential_rad"], records["normal_rad"] = 0.002 * np.sin(t_s), 0.001 * np.cos(t_s)
    if now["mode"] in ("DISARMED", "HOLD") and now["tension_n"] < 5:
        records["vertical_n"] = records["tension_n"] = now["tension_n"]
        records["stroke_mm"], records["speed_mm_s"] = now["stroke_mm"], 0.0
    if now["mode"] == "TENSIONING":
        share = np.clip((t_s - 46.0) / 14.0, 0.0, 1.0)
        records["vertical_n"] = records["tension_n"] = share * now["tension_n"]
        records["stroke_mm"], records["speed_mm_s"] = share * now["stroke_mm"], (share > 0) * now["speed_mm_s"]
    if now["mode"] == "FAULT":
        before = slice(None, -700)
        records["mode"][before] = int(Mode.COMPENSATING)
        records["cause_bits"][-700:] = bits_of(Fault[cause["fault"]] for cause in now["causes"])
        for name in ("vertical_n", "tension_n", "stroke_mm", "speed_mm_s"):
            records[name][-700:] = now[name] if name != "speed_mm_s" else 0.0
    records["lateness_ns"] = 1000 + 50_000 * (np.arange(count) % 7)
    picture.add_records(records, time.time_ns() - int(records["t_ns"][-1]))


def show(picture: Picture, shown: Shown) -> None:
    """Have a picture show another state."""
    picture.add_events(shown.events, anew=True)
    picture.take_state(shown.state)


@contextlib.contextmanager
def page_of(picture: Picture) -> Iterator[Callable[[], str]]:
    """A page that shows a picture, with operator rights; its commands reach no rig. Yields new addresses of it."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        guard = Guard.of(Address(*listening.getsockname()), operator="kim")
        page = Page(picture, guard, PageCommands("kim", "paper_rig", picture))
        server = uvicorn.Server(uvicorn.Config(page.app, lifespan="off", log_level="error"))
        thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[listening])), daemon=True)
        ended = threading.Event()

        def refresh() -> None:
            while not ended.wait(0.1):
                if picture.state is not None:
                    picture.take_state({**picture.state, "wall_ns": time.time_ns()})

        refreshing = threading.Thread(target=refresh, daemon=True)
        thread.start()
        refreshing.start()
        try:
            until(lambda: server.started, "the page's server")
            yield guard.link
        finally:
            ended.set()
            server.should_exit = True
            thread.join()
            refreshing.join()
            page.close()
