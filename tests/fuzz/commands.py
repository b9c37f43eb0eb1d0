"""Random commands: bytes into the parsers of an operator's queries, and valid commands into the real loop."""

from __future__ import annotations

import json
import math
import random
from typing import Any

import numpy as np

from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.modes import command_slot
from rigctl.gateway import command_server
from rigctl.ipc.ring import RingReader
from rigctl.model.faults import Fault
from rigctl.model.lease_acts import ACTS
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.wire.alarms import ALARM_ACTS
from rigctl.wire.command_request import RequestError
from tests.fuzz import mutate
from tests.fuzz.frames import ONWARD
from tests.fuzz.judge import Tally

_OPTIONS: dict[Verb, dict[str, Any]] = {
    Verb.ARM: {"near_end": False},
    Verb.TARGET: {"value": 290.0},
    Verb.CONFIRM_STROKE: {"value": 1.0},
    Verb.MOVE: {"value": 1.0},
    Verb.CARRY: {"value": 60.0},
    Verb.CALIBRATE: {"value": 300.0, "adopt": False},
    Verb.IDENTIFY: {"tight": True},
    Verb.RESPONSE: {"where": "hold"},
    Verb.GAINS: {"gain_file": "gains: {}\n", "name": "gains.yaml"},
}
_NAMES = ("", "Arm", "arm ", "arm/..", "*", "**", "lease_take", "lease_return", "é" * 300, "a\nb", "none", "0")
_NONE = (None, b"", b"null", b"[]", b"{}", b"[" * 100_000, b"{" * 16_000, b" " * 20_000, b"\xff" * 99)
PRESSED = 0.005  # share of commands given after an emergency stop: no command by itself leads to FAULT
PRESSED_TICKS = 300


def query(chance: random.Random, mode: Mode) -> tuple[str, bytes | None]:
    """End of a key and a payload: mostly a command that changes the mode, else a random or invalid one."""
    verb = chance.choice(ONWARD[mode]) if chance.random() < 0.6 else chance.choice(list(Verb))
    body: Any = {"operator": "anna", **_OPTIONS.get(verb, {})}
    if verb is Verb.TARGET:
        body["value"] = chance.uniform(-50.0, 500.0)
    name = chance.choice((*_NAMES, *ACTS, *ALARM_ACTS)) if chance.random() < 0.1 else verb.name.lower()
    kind = chance.random()
    if kind < 0.4:
        return name, json.dumps(body).encode()
    if kind < 0.75:
        try:
            return name, json.dumps(mutate.data(body, chance)).encode()
        except RecursionError:
            return name, b"[" * 5000
    if kind < 0.95:
        return name, mutate.raw(json.dumps(body).encode(), chance)
    return name, chance.choice(_NONE)


def parsed(name: str, payload: bytes | None) -> object:
    """Parse a query as the command server does."""
    return command_server.parsed(name, payload)


def play(settings: RigSettings, gains: Gains, count: int, seed: int) -> Tally:
    """Parse ``count`` commands; give the valid ones to a loop with a simulated rig, and judge its output."""
    tally, chance = Tally(), random.Random(seed)
    sent = 0
    with lockstep(settings, gains) as rig:
        loop, ring, answers = rig.loop, rig.runtime.commands.writer(), rig.runtime.replies.reader()
        rig.run(0.2)
        answered = _take(answers)
        for _ in range(count):
            if chance.random() < PRESSED:
                rig.rig.drive.press_e_stop(True)
                _judge(rig, PRESSED_TICKS, tally)
                rig.rig.drive.press_e_stop(False)
            name, payload = query(chance, loop.machine.mode)
            found = tally.attempt("command", payload or b"", lambda n=name, p=payload: parsed(n, p), (RequestError,))  # type: ignore[misc]
            if isinstance(found, Request):
                sent += 1
                ring.write(*command_slot(rig.clock.now(), sent, found.verb, found.number))
            ticks = chance.choice((1, 2, 3, 5, 8)) if chance.random() < 0.99 else chance.choice((300, 2000, 5000))
            _judge(rig, ticks, tally)
            answered += _take(answers)
        loop.stop_requested = True
        _judge(rig, 3000, tally)
        answered += _take(answers)
        tally.tried["given to the loop"] += sent
        if answered != sent:
            tally.wrong.append(f"{sent} commands given, {answered} answered")
        if not loop.finished:
            tally.wrong.append("the loop has not stopped")
    return tally


def _judge(rig: Lockstep, ticks: int, tally: Tally) -> None:
    """Check that the commands to the drive are finite and inside their limits, and that no exception was raised."""
    records = rig.run(ticks / rig.settings.loop.rate_hz)
    for mode in np.unique(records["mode"]):
        tally.taken[f"in {Mode(mode).name}"] += 1
    if not np.isfinite(records["command_mm_s"]).all() or not np.isfinite(records["estimate_n"]).all():
        tally.wrong.append("not finite in the record")
    elif abs(records["command_mm_s"]).max() > rig.settings.tension.speed_max_mm_s:
        tally.wrong.append(f"commands {abs(records['command_mm_s']).max()} mm/s")
    if (records["fault"] == Fault.LOOP_EXCEPTION).any():
        tally.wrong.append("an exception in the loop")
    if not math.isfinite(rig.loop.law.target_n):
        tally.wrong.append(f"target {rig.loop.law.target_n}")


def _take(answers: RingReader) -> int:
    return len(answers.read())
