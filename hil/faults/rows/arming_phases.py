"""The phases of arming in which a fault may come, and the way to them."""

from __future__ import annotations

from collections.abc import Callable

from hil.lockstep import Lockstep
from hil.nodes.power_stage import StagePhase
from rigctl.model.verbs import Verb

LONGEST_S = 6.0
"""Read-back, standstill, brake test and the drive's own time."""
BRAKE_TEST = ("cylinder.brake_test", True)


def opens_brake(rig: Lockstep) -> bool:
    """The motor has its current, the brake is opening."""
    return rig.rig.drive.control.stage.phase is StagePhase.OPENING


def _reads_back(rig: Lockstep) -> bool:
    return rig.loop.readback.reading_all


def _waits_on_brake(rig: Lockstep) -> bool:
    return rig.view.awaiting


def _enables(rig: Lockstep) -> bool:
    return rig.view.taking and not opens_brake(rig)


PHASES: dict[str, Callable[[Lockstep], bool]] = {
    "reading": _reads_back,
    "testing": _waits_on_brake,
    "enabling": _enables,
    "opening": opens_brake,
}
"""In their order: read-back of the settings, brake test, drive commanded on, brake opening."""


def arm_until(rig: Lockstep, phase: str) -> None:
    """Give ARM and run until its ``phase``.

    Raises:
        RuntimeError: the phase did not come.
    """
    reached = PHASES[phase]
    rig.give(Verb.ARM, 0.0)
    for _ in range(round(LONGEST_S * rig.settings.loop.rate_hz)):
        rig.tick()
        if reached(rig):
            return
    raise RuntimeError(f"the arming did not come to {phase!r}")
