"""Faults of the catalogue put into a running rig, and taken out again."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
import pytest

from hil.faults.catalogue import BY_ID, CATALOGUE
from hil.faults.expected import InjectedFault
from hil.faults.judging.standing import FaultRefusedError, StandingFault, found, hindrance
from hil.faults.stand import Needs
from hil.lockstep import Lockstep, lockstep
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.paths import ROOT

SETTINGS = rig_file.load(ROOT / "config/paper_rig.yaml")
INJECTABLE = [fault for fault in CATALOGUE if not hindrance(fault, served=True)]
LENGTH_S, TICK_S = 0.03, 0.001


@pytest.fixture(scope="module")
def gains() -> Gains:
    return design_and_check(SETTINGS).gains


@contextlib.contextmanager
def armed(gains: Gains) -> Iterator[Lockstep]:
    with lockstep(SETTINGS, gains) as subject:
        subject.rig.plant.preload(300.0)
        subject.run(0.6)
        assert subject.command(Verb.ARM) is Refusal.NONE
        yield subject


@pytest.fixture
def rig(gains: Gains) -> Iterator[Lockstep]:
    with armed(gains) as subject:
        yield subject


@pytest.fixture(scope="module")
def same_rig(gains: Gains) -> Iterator[Lockstep]:
    """Armed once: the faults of the catalogue are put into it one after another."""
    with armed(gains) as subject:
        yield subject


def pass_by(rig: Lockstep, fault: StandingFault, most: int = 1000) -> int:
    """Ticks that the fault stood."""
    for tick in range(most):
        if not fault.step(rig.clock.now()):
            return tick
        rig.run(TICK_S)
    return most


def readings(rig: Lockstep) -> list[dict[tuple[int, int], object]]:
    return [dict(node.readers) for node in rig.rig.nodes]


def test_a_fault_for_a_while_trips_as_in_the_catalogue_and_its_cause_goes(rig: Lockstep) -> None:
    fault = StandingFault(rig, BY_ID["cell_silent"], rig.clock.now(), LENGTH_S)
    assert pass_by(rig, fault) == round(LENGTH_S / TICK_S)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.CELL_STALE)
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert rig.loop.machine.mode is Mode.HOLD


def test_a_fault_without_an_end_stands_until_it_is_ended(rig: Lockstep) -> None:
    fault = StandingFault(rig, BY_ID["cell_silent"], rig.clock.now())
    assert pass_by(rig, fault, 100) == 100
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    fault.end()
    assert not fault.step(rig.clock.now())
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE


def defects(rig: Lockstep) -> tuple[object, ...]:
    drive, brake = rig.rig.drive, rig.rig.drive.brake
    of_brake = (brake.stuck_closed, brake.stuck_open, brake.drag_n, brake.slip_mm_s)
    return (drive.defect, drive.rpdo_defect, *of_brake, *(node.hears_sync for node in rig.rig.nodes))


@pytest.mark.parametrize("fault", INJECTABLE, ids=lambda fault: fault.id)
def test_after_its_end_wire_readings_drive_and_mechanics_are_as_before(
    same_rig: Lockstep, fault: InjectedFault
) -> None:
    """Whatever it does; a device that the rig lacks is named instead."""
    rig = same_rig
    before = readings(rig), np.array(rig.rig.plant.parameters), defects(rig)
    try:
        standing = StandingFault(rig, fault, rig.clock.now(), LENGTH_S)
    except FaultRefusedError as error:
        assert str(error).startswith(f"{fault.id}: this rig")
    else:
        pass_by(rig, standing)
    assert readings(rig) == before[0]
    assert np.array_equal(rig.rig.plant.parameters, before[1])
    assert defects(rig) == before[2]
    assert (rig.rig.drive.tool, rig.hub.tap) == (None, None)
    rig.run(TICK_S)


def test_every_fault_is_injectable_or_says_why_not() -> None:
    assert len(INJECTABLE) >= 90
    for fault in CATALOGUE:
        why = hindrance(fault, served=True)
        assert bool(why) == (fault.needs in (Needs.LOOP, Needs.START))
    with pytest.raises(FaultRefusedError, match="found 'none_such', expected a fault of the catalogue"):
        found("none_such")


def test_a_rig_without_the_device_says_so(gains: Gains) -> None:
    settings: RigSettings = SETTINGS.model_copy(update={"io": None})
    with lockstep(settings, gains) as rig, pytest.raises(FaultRefusedError, match="this rig has no I/O node"):
        StandingFault(rig, BY_ID["io_e_stop"], rig.clock.now())
