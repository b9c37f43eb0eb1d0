"""A rig that is the wrong way round is caught in its first tensioning, before it has moved or pulled much."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.config import RigSettings
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.safety import Fault
from rigctl.control.tension import Gains
from rigctl.telemetry.events import Kind
from tests.loop.test_trials import cell_reads

Enter = Callable[[Mode], None]


def swap_drive(rig: Lockstep) -> None:
    """The motor's wires are swapped; its encoder tells the truth."""
    plain = rig.rig.plant.set_drive

    def swapped(velocity_mm_s: float, braked: bool) -> None:
        plain(-velocity_mm_s, braked)

    rig.rig.plant.set_drive = swapped  # type: ignore[method-assign]


def swap_drive_and_encoder(rig: Lockstep) -> None:
    """The cylinder lengthens the rope when drive and encoder both say that it shortens it."""
    swap_drive(rig)
    encoder = type(rig.rig.drive._encoder)
    start = rig.rig.truth.stroke_mm

    class Mirrored(encoder):  # type: ignore[misc, valid-type]
        @property
        def position_mm(self) -> float:
            return float(2.0 * start - super().position_mm)

    rig.rig.drive._encoder.__class__ = Mirrored


def test_a_rig_the_right_way_round_passes_once_and_is_told(rig: Lockstep, enter: Enter) -> None:
    enter(Mode.COMPENSATING)
    told = rig.events.read()
    told = told[told["kind"] == Kind.SIGNS]
    assert len(told) == 1
    # The screw's play of 0.05 mm is within this stretch of 2.5 mm.
    assert told["value"][0] == pytest.approx(rig.settings.plant.stiffness_n_mm, rel=0.03)
    assert rig.command(Verb.RELEASE) is Refusal.NONE
    rig.run_until(Mode.HOLD, 10.0)
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run_until(Mode.COMPENSATING, 10.0)
    assert Kind.SIGNS not in rig.events.read()["kind"]


def test_a_swapped_drive_is_caught_within_half_a_millimetre(rig: Lockstep, enter: Enter) -> None:
    enter(Mode.HOLD)
    swap_drive(rig)
    before = rig.rig.truth.stroke_mm
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(0.2)
    assert rig.loop.machine.fault in (Fault.SIGN_DRIVE, Fault.DRIVE_NOT_FOLLOWING)
    rig.run(1.0)
    assert abs(rig.rig.truth.stroke_mm - before) < 0.6
    assert rig.rig.truth.speed_mm_s == pytest.approx(0.0, abs=1e-6)


def test_a_swapped_cell_is_caught_before_the_rope_pulls_more_than_slack(rig: Lockstep, enter: Enter) -> None:
    enter(Mode.HOLD)
    cell_reads(rig, lambda n: -n)
    assert rig.command(Verb.TENSION) is Refusal.NONE
    records = rig.run(2.0)
    assert rig.loop.machine.fault is Fault.SIGN_CELL
    assert rig.rig.truth.tension_n < rig.settings.tension.slack_n + 4.0  # what a stop from 8 mm/s adds
    assert np.count_nonzero(records["mode"] == Mode.TENSIONING) < 1000


def tight(settings: RigSettings, gains: Gains, spoil: Callable[[Lockstep], None]) -> tuple[Fault, float]:
    """Fault and largest deviation of tension of a daemon that starts with 250 N on the rope, spoilt."""
    with lockstep(settings, gains) as rig:
        rig.rig.plant.preload(250.0)
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        spoil(rig)
        rig.run(0.1)
        before = rig.rig.truth.tension_n
        assert before > 200.0
        assert rig.command(Verb.TENSION) is Refusal.NONE
        deviation = 0.0
        for _ in range(1500):
            rig.loop.tick()
            deviation = max(deviation, abs(rig.rig.truth.tension_n - before))
        return rig.loop.machine.fault, deviation


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (swap_drive, {Fault.SIGN_DRIVE, Fault.INNOVATION}),
        (swap_drive_and_encoder, {Fault.SIGN_CELL, Fault.INNOVATION}),
        (lambda rig: cell_reads(rig, lambda n: -n), {Fault.SIGN_CELL}),
    ],
)
def test_on_a_tight_rope_too(
    settings: RigSettings, gains: Gains, spoil: Callable[[Lockstep], None], fault: set[Fault]
) -> None:
    found, deviation_n = tight(settings, gains, spoil)
    assert found in fault
    assert deviation_n < 15.0


def test_a_spring_that_is_not_the_files_is_caught(rig: Lockstep, enter: Enter) -> None:
    enter(Mode.HOLD)
    cell_reads(rig, lambda n: 0.25 * n)
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(4.0)
    assert rig.loop.machine.fault is Fault.SIGN_CELL
