"""What tests of the loop in lockstep put on the simulated rig's bus, and what they look for afterwards."""

from __future__ import annotations

import pytest

from hil.lockstep import Lockstep
from rigctl.devices import objects as od
from rigctl.model.events import Kind, Worded, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode


def events(rig: Lockstep) -> list[int]:
    return [int(slot["kind"]) for slot in rig.events.read()]


def worded_events(rig: Lockstep) -> list[tuple[int, Worded]]:
    """Kind and words of the events since the last call."""
    found = []
    for event in rig.events.read():
        number, a, b, value, limit, text = (event[n].item() for n in ("kind", "a", "b", "value", "limit", "text"))
        found.append((number, worded(number, a, b, value, limit, text.decode())))
    return found


def texts(rig: Lockstep, kind: Kind) -> list[str]:
    """The events of a kind since the last call, in words."""
    return [event.text for number, event in worded_events(rig) if number == kind]


def latched(rig: Lockstep) -> tuple[Mode, Fault, Action]:
    """Mode, latched fault and the reaction to it."""
    return rig.loop.machine.mode, rig.loop.machine.fault, rig.view.action


def stop_node(rig: Lockstep, node: int) -> None:
    rig.rig.receive(nmt(2, node))


def nmt(command: int, node: int) -> bytes:
    return od.NMT_COB.to_bytes(4, "little") + bytes([2, 0, 0, 0, command, node]) + bytes(6)


def assert_held(rig: Lockstep, tension_n: float, stroke_mm: float) -> None:
    """The load is carried: stroke within a millimetre, tension within 3 % or 6 N, and it stays so."""
    rig.run(1.0)
    truth = rig.rig.truth
    assert abs(truth.stroke_mm - stroke_mm) < 1.0
    assert abs(truth.tension_n - tension_n) < max(0.03 * tension_n, 6.0)
    assert truth.speed_mm_s == pytest.approx(0.0, abs=1e-6)


def frame(can_id: int, data: bytes) -> bytes:
    return can_id.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0")
