"""A stand-in for the control process: writes records at 1 kHz and events, and answers commands.

``python stand_in.py RUNTIME_DIR`` runs until SIGTERM. ``arm`` takes 0.3 s, like a drive.
A target of 111 N is never answered, one of 222 N trips. Ramps take half a second, or never end with ``--slow``.
"""

from __future__ import annotations

import math
import pathlib
import signal
import sys
import time
from dataclasses import replace
from typing import Any

from rigctl.control.bus.hold_sockets import HoldSockets
from rigctl.control.commands.situation import Situation, slot_values
from rigctl.control.modes import TRANSITIONS, Decision, decide, next_mode
from rigctl.ipc.hold_socket import HoldAnswer
from rigctl.ipc.record import RECORD, REPLY
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Flag, HeldBy, Mode
from rigctl.model.verbs import Refusal, Setting, Verb

PERIOD_NS = 1_000_000
ARM_NS = 300_000_000
SILENT_N, TRIP_N = 111.0, 222.0


class StandIn:
    """Modes and a tension that follows them."""

    def __init__(self, runtime: Runtime) -> None:
        self.records, self.events = runtime.records.writer(), runtime.events.writer()
        self.situations = runtime.situations.writer()
        self.replies, self.commands = runtime.replies.writer(), runtime.commands.reader()
        self.holds = HoldSockets.of(runtime)
        self.mode, self.fault, self.target, self.tension, self.stroke = Mode.DISARMED, Fault.NONE, 300.0, 0.0, 0.0
        self.arming: tuple[int, int] | None = None
        self.own, self.host = 0, int(Check.HOST)
        self.step = 0.6  # N a tick

    @property
    def failed(self) -> int:
        return self.own | self.host

    def situation(self) -> Situation:
        on = self.mode is not Mode.DISARMED
        return Situation(
            self.failed, fault=self.fault, armed=on, powered=on, slack=self.tension < 5, unloaded=True,
            room_mm=60.0, stroke_mm=self.stroke, target_min_n=50.0, target_max_n=350.0,
            pending=Verb.ARM if self.arming else 0,
        )  # fmt: skip

    def event(self, now: int, kind: Kind, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0) -> None:
        self.events.write(now, int(kind), a, b, value, limit, b"")

    def move(self, now: int, event: Event) -> None:
        before, self.mode = self.mode, next_mode(self.mode, event)
        if before is not self.mode:
            self.event(now, Kind.MODE, before, self.mode, float(event))

    def reply(self, now: int, number: int, decision: Decision, checks: int = 0) -> None:
        accepted = decision.refusal is Refusal.NONE
        self.replies.write(*REPLY.values(
            t_ns=now, id=number, accepted=accepted, reason=decision.refusal, checks=checks, mode=self.mode,
            target_n=self.target,
        ))  # fmt: skip

    def take(self, now: int, command: Any) -> None:
        target, number = float(command["target_n"]), int(command["id"])
        if int(command["verb"]) == Setting.HOST_CHECKS:
            self.host = int(command["host_checks"])
            self.reply(now, number, Decision())
            return
        verb = Verb(int(command["verb"]))
        if verb is Verb.TARGET and target == SILENT_N:
            return
        decision = decide(self.mode, verb, replace(self.situation(), wanted_n=target))
        if decision.refusal is Refusal.NONE and verb is Verb.ARM:
            self.arming = (number, now + ARM_NS)
            return
        if decision.event is not None and (self.mode, decision.event) in TRANSITIONS:
            self.move(now, decision.event)
        if decision.refusal is Refusal.NONE and verb is Verb.TARGET:
            self.target = target
        if decision.refusal is Refusal.NONE and verb is Verb.RESET:
            self.event(now, Kind.RESET, self.fault)
            self.fault = Fault.NONE
        self.reply(now, number, decision, self.failed if decision.refusal is Refusal.PREFLIGHT else 0)
        if verb is Verb.TARGET and target == TRIP_N:
            self.fault = Fault.TENSION_HIGH
            self.event(now, Kind.TRIP, self.fault, Action.HOLD, 412.0, 400.0)
            self.move(now, Event.TRIP)

    def hold(self, now: int) -> None:
        decision = decide(self.mode, Verb.HOLD, Situation(self.failed, armed=self.mode is not Mode.DISARMED))
        if decision.event is not None and (self.mode, decision.event) in TRANSITIONS:
            self.move(now, decision.event)
        done, mode = decision.refusal is Refusal.NONE, self.mode.name
        answer = HoldAnswer(now, done, decision.refusal, 0, self.fault, self.stroke, self.tension, mode)
        self.holds.answer(now, answer)

    def tick(self, now: int, tick: int, late: int) -> None:
        if self.holds.take(now) is not None:
            self.hold(now)
        for command in self.commands.read():
            self.take(now, command)
        if self.arming and now >= self.arming[1]:
            self.move(now, Event.ENABLED)
            self.reply(now, self.arming[0], Decision())
            self.arming = None
        step = {Mode.TENSIONING: self.step, Mode.RELEASING: -self.step}.get(self.mode, 0.0)
        self.tension = max(0.0, self.tension + step)
        self.stroke = self.tension / 6.0
        if self.mode is Mode.TENSIONING and self.tension >= self.target:
            self.tension = self.target
            self.move(now, Event.TENSIONED)
        if self.mode is Mode.RELEASING and self.tension <= 5.0:
            self.move(now, Event.SLACK)
        wobble = 0.1 * math.sin(now / 1e9) if self.mode is Mode.COMPENSATING else 0.0
        vertical = self.tension + wobble
        values: dict[str, Any] = dict.fromkeys((field.name for field in RECORD.fields), 0) | {
            "t_ns": now, "tick": tick, "lateness_ns": late, "work_ns": 80_000 + tick % 1000, "mode": int(self.mode),
            "fault": int(self.fault), "tension_n": vertical, "vertical_n": vertical, "target_n": self.target,
            "sink_mm_s": math.nan, "slack_s": math.nan, "end_s": math.nan, "setpoint_n": self.target,
            "drive_current_a": 0.7, "drive_temperature_c": 25.0,
            "flags": 0 if self.mode is Mode.DISARMED else int(Flag.DRIVE_ENABLED),
            "held_by": int(HeldBy.BRAKE if self.mode is Mode.DISARMED else HeldBy.MOTOR),
            "stroke_mm": self.stroke, "tangential_rad": 0.1 * math.sin(now / 5e9), "normal_rad": math.nan,
            "inclination_quality": 1, "frames_sent": tick, "checks": self.failed,
        }  # fmt: skip
        self.records.write(*values.values())
        if tick % 100 == 0:
            self.situations.write(*slot_values(now, self.mode, self.situation()))


def main() -> None:
    runtime = Runtime(pathlib.Path(sys.argv[1]))
    stop = []
    signal.signal(signal.SIGTERM, lambda *_: stop.append(1))
    loop = StandIn(runtime)
    if "--fail-preflight" in sys.argv:
        loop.own = int(Check.CELL_STALE | Check.STROKE_RANGE)
    if "--slow" in sys.argv:
        loop.step = 0.0
    runtime.write_json("control.json", {"warnings": ["SCHED_FIFO 80 refused: not permitted"], "realtime": []})
    start = due = time.monotonic_ns()
    loop.event(start, Kind.STARTED)
    while not stop:
        now = time.monotonic_ns()
        if now < due:
            time.sleep((due - now) / 1e9)
        while due <= time.monotonic_ns():  # no tick is left out: the tests count them
            loop.tick(due, (due - start) // PERIOD_NS, time.monotonic_ns() - due)
            due += PERIOD_NS


if __name__ == "__main__":
    main()
