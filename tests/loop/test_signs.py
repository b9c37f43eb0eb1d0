"""A rig with a reversed sign is detected in its first tensioning, before it has moved or pulled much."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import RAMP_EASE_S, Gains
from rigctl.control.watch.signs import SLOPE_N
from rigctl.design.margins import design_and_check
from rigctl.devices.objects import MM_PER_POSITION_UNIT
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.loop.test_trials import cell_reads


def swap_drive(rig: Lockstep) -> None:
    """Swap the motor's wires; the encoder stays right."""
    plain = rig.rig.plant.set_drive

    def swapped(velocity_mm_s: float, braked: bool, yielding_mm_s: float = 0.0) -> None:
        plain(-velocity_mm_s, braked, yielding_mm_s)

    rig.rig.plant.set_drive = swapped  # type: ignore[method-assign]


def swap_drive_and_encoder(rig: Lockstep) -> None:
    """Make the cylinder lengthen the rope where drive and encoder report that it shortens it."""
    swap_drive(rig)
    encoder = type(rig.rig.drive._encoder)
    start = rig.rig.truth.stroke_mm

    class Mirrored(encoder):  # type: ignore[misc, valid-type]
        @property
        def position_mm(self) -> float:
            return float(2.0 * start - super().position_mm)

    rig.rig.drive._encoder.__class__ = Mirrored


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_rig_the_right_way_round_passes_once_and_is_told(rig: Lockstep) -> None:
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


@pytest.mark.parametrize(
    ("scale", "section", "change", "warns"),
    [
        (0.75, "calibration.waiver", "a simulated rig", True),
        (0.75, "calibration", None, True),
        (0.75, "calibration.waiver", None, False),
        (1.0, "calibration.waiver", "a simulated rig", False),
        (1.18, "calibration.waiver", "a simulated rig", False),
        (1.25, "calibration.waiver", "a simulated rig", True),
    ],
)
def test_a_stiffness_that_is_off_is_a_warning_where_nothing_else_checks_the_cells_scale(
    settings: RigSettings, gains: Gains, scale: float, section: str, change: str | None, warns: bool
) -> None:
    """A cell that reads 0.75 of the tension has 400 N for 300, the limit of the shipped rigs."""
    alone = changed(settings, {"cylinder.force_per_ampere_n": None, section: change})
    with lockstep(alone, gains) as rig:
        rig.run(0.2)
        cell_reads(rig, lambda n: n * scale)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(3.0)
        events = rig.events.read()
    (found,) = events[events["kind"] == Kind.SIGNS]
    event = worded(found["kind"], found["a"], found["b"], found["value"], found["limit"], found["text"].decode())
    assert (event.severity == "warning", "known weight" in event.text) == (warns, warns)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_swapped_drive_is_caught_within_half_a_millimetre(rig: Lockstep) -> None:
    swap_drive(rig)
    before = rig.rig.truth.stroke_mm
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(0.2)
    assert rig.loop.machine.fault in (Fault.SIGN_DRIVE, Fault.DRIVE_NOT_FOLLOWING)
    rig.run(1.0)
    assert abs(rig.rig.truth.stroke_mm - before) < 0.6
    assert rig.rig.truth.speed_mm_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_swapped_cell_is_caught_before_the_rope_pulls_more_than_slack(rig: Lockstep) -> None:
    cell_reads(rig, lambda n: -n)
    assert rig.command(Verb.TENSION) is Refusal.NONE
    records = rig.run(2.0)
    assert rig.loop.machine.fault is Fault.SIGN_CELL
    assert rig.rig.truth.tension_n < rig.settings.tension.slack_n + 4.0  # added by a stop from 8 mm/s
    assert np.count_nonzero(records["mode"] == Mode.TENSIONING) < 1000


@dataclass(frozen=True)
class Tensioned:
    """Tensioning of a rope that was already tight: largest deviations of the truth in N and mm."""

    fault: Fault
    off_n: float
    off_mm: float
    mode: Mode
    compensated: bool
    told: list[Kind]


def tight(
    settings: RigSettings, gains: Gains, tension_n: float, spoil: Callable[[Lockstep], None] = lambda _rig: None
) -> Tensioned:
    """Start a daemon with this tension on the rope, on a rig with a fault; only the built-in limits."""
    with lockstep(settings.model_copy(update={"limits": []}), gains) as rig:
        rig.rig.plant.preload(tension_n)
        rig.run(1.0)  # the filter settles on the load, so that it does not detect the fault itself
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(0.1)
        assert rig.view.rejects == 0
        spoil(rig)
        before, off_n, off_mm, compensated = rig.rig.truth, 0.0, 0.0, False
        assert before.tension_n == pytest.approx(tension_n, abs=5.0)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        for _ in range(3000):
            rig.loop.tick()
            off_n = max(off_n, abs(rig.rig.truth.tension_n - before.tension_n))
            off_mm = max(off_mm, abs(rig.rig.truth.stroke_mm - before.stroke_mm))
            compensated |= rig.loop.machine.mode is Mode.COMPENSATING
        told = [Kind(kind) for kind in rig.events.read()["kind"].tolist()]
        return Tensioned(rig.loop.machine.fault, off_n, off_mm, rig.loop.machine.mode, compensated, told)


@pytest.mark.gate("swap_drive-fault0", "<lambda>-fault3")
@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (swap_drive, {Fault.SIGN_DRIVE, Fault.DRIVE_NOT_FOLLOWING}),
        (swap_drive_and_encoder, {Fault.SIGN_CELL}),
        (lambda rig: cell_reads(rig, lambda n: 500.0 - n), {Fault.SIGN_CELL}),
        (lambda rig: cell_reads(rig, lambda n: -n), {Fault.CELL_NEGATIVE}),
    ],
)
def test_on_a_tight_rope_too(
    settings: RigSettings, gains: Gains, spoil: Callable[[Lockstep], None], fault: set[Fault]
) -> None:
    found = tight(settings, gains, 250.0, spoil)
    assert found.fault in fault
    assert found.off_n < 15.0
    assert not found.compensated


@pytest.mark.gate("6.0-300.0")
@pytest.mark.parametrize(("spring_n_mm", "target_n"), [(6.0, 300.0), (6.0, 50.0), (None, 300.0)])
def test_a_rope_that_is_tight_and_on_target_is_felt_before_the_loop_closes_for_good(
    settings: RigSettings, spring_n_mm: float | None, target_n: float
) -> None:
    plant = settings.plant.model_copy(update={"spring_n_mm": spring_n_mm})
    tension = settings.tension.model_copy(update={"target_n": target_n})
    settings = settings.model_copy(update={"plant": plant, "tension": tension})
    found = tight(settings, design_and_check(settings).gains, target_n)
    assert (found.fault, found.mode) == (Fault.NONE, Mode.COMPENSATING)
    assert Kind.SIGNS in found.told
    turn_n = 0.5 * settings.tension.ramp_n_s * RAMP_EASE_S  # the ramp back takes over at this speed, and eases
    count_n = plant.stiffness_n_mm * MM_PER_POSITION_UNIT  # of the drive's position: 1 N without a spring
    assert SLOPE_N - 1.0 < found.off_n < SLOPE_N + turn_n + 1.0 + count_n


@pytest.mark.gate("6.1-0")
@pytest.mark.parametrize(("said_n_mm", "fault"), [(6.1, Fault.NONE), (None, Fault.SIGN_CELL)])
def test_a_mechanism_softer_than_the_spring_is_no_wrong_sign_where_the_file_says_so(
    settings: RigSettings, said_n_mm: float | None, fault: Fault
) -> None:
    """At 34 N/mm on 6.1 N/mm a slow stroke meets 5.2 N/mm: a sixth of what a rigid mechanism gives."""
    values = {"plant.spring_n_mm": 34.0, "plant.mechanism_n_mm": said_n_mm, "simulation.mechanism.vertical_n_mm": 6.1}
    its = changed(settings, values)
    with lockstep(its, design_and_check(changed(its, {"plant.mechanism_n_mm": 6.1})).gains) as rig:
        rig.run(0.5)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run_until(Mode.HOLD, 2.0)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(10.0)
        assert rig.loop.machine.fault is fault
        assert (rig.loop.machine.mode is Mode.COMPENSATING) == (fault is Fault.NONE)


def test_where_the_stroke_ends_it_is_felt_the_other_way(settings: RigSettings, gains: Gains) -> None:
    cylinder = settings.cylinder.model_copy(update={"stroke_min_mm": -1.0})
    found = tight(settings.model_copy(update={"cylinder": cylinder}), gains, settings.tension.target_n)
    assert (found.fault, found.mode) == (Fault.NONE, Mode.COMPENSATING)
    assert Kind.SIGNS in found.told


@pytest.mark.gate("swap_drive_and_encoder-fault1")
@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (swap_drive, {Fault.SIGN_DRIVE, Fault.DRIVE_NOT_FOLLOWING}),
        (swap_drive_and_encoder, {Fault.SIGN_CELL}),
        (lambda rig: cell_reads(rig, lambda n: 600.0 - n), {Fault.SIGN_CELL}),
    ],
)
def test_on_target_too_each_wrong_way_round_is_caught_before_the_loop_is_closed_for_good(
    settings: RigSettings, gains: Gains, spoil: Callable[[Lockstep], None], fault: set[Fault]
) -> None:
    found = tight(settings, gains, settings.tension.target_n, spoil)
    assert found.fault in fault
    assert not found.compensated
    assert found.off_n < 20.0
    assert Fault.SIGN_CELL in fault or found.off_mm < 0.5


@pytest.mark.gate("0.344", "1.5")
@pytest.mark.parametrize("share", [0.25, 0.344, 1.5])  # 0.344: lengths 2.9 times too long
def test_a_stiffness_that_the_assumed_family_has_not_ends_the_tensioning(
    settings: RigSettings, gains: Gains, share: float
) -> None:
    """Without the motor's current, which shows the two small shares before."""
    with lockstep(changed(settings, {"cylinder.force_per_ampere_n": None}), gains) as rig:
        rig.run(0.2)
        cell_reads(rig, lambda n: share * n)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(4.0)
        assert rig.loop.machine.fault is Fault.SIGN_CELL
        assert rig.rig.truth.tension_n < 200.0  # shown within 60 N
        (trip,) = [event for event in rig.events.read() if event["kind"] == Kind.TRIP]
    text = trip["text"].decode()
    words = worded(trip["kind"], trip["a"], trip["b"], trip["value"], trip["limit"], text).text
    assert re.search(r"\d N/mm found, 2.26 to 8.23 N/mm expected\)", words), words
