"""The proof of a gain table's transitions, held against products of the loops it is about."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from rigctl.config.changed_settings import changed
from rigctl.design import transitions
from rigctl.design.closed_loop import closed_loop
from rigctl.design.gains import design
from rigctl.design.plant_family import Family, sampled
from rigctl.design.transitions import EntryLoop, TransitionError, dwell_time_s
from tests.builders.rig_bench import SETTINGS


def entry(stiffness_n_mm: float, **changes: object) -> EntryLoop:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    spring = {"plant.spring_n_mm": None, "plant.rope_n_mm": stiffness_n_mm, "plant.rope_damping_n_s_mm": 0.0}
    settings = changed(SETTINGS, {**spring, **values})
    return EntryLoop(settings, design(settings), Family("test", (sampled(settings, None, 1.0, 1.0, 1.0, 2.0),)))


def test_sequences_that_keep_the_dwell_time_die_out_on_every_plant() -> None:
    entries = [entry(5.0), entry(7.0), entry(9.0)]
    dwell = dwell_time_s(entries)
    assert 0.0 < dwell < 10.0
    ticks = round(dwell * SETTINGS.loop.rate_hz)
    parts = [transitions._parts(each) for each in entries]
    for each in entries:
        (plant,) = each.family.members
        for sequence in itertools.permutations(range(3)):
            total = np.eye(len(closed_loop(plant, parts[0].opened).a))
            for before, after in zip(sequence, (*sequence[1:], sequence[0]), strict=True):
                law, errors = parts[before].opened, parts[before].errors
                change = transitions._change(plant, law, errors, parts[before].gains, parts[after].gains)
                stays = np.linalg.matrix_power(closed_loop(plant, parts[after].opened).a, ticks)
                total = stays @ change @ total
            assert np.abs(np.linalg.eigvals(total)).max() < 1.0


def test_entries_that_are_alike_may_change_almost_at_once_and_far_ones_later() -> None:
    near, far = dwell_time_s([entry(6.0), entry(6.06)]), dwell_time_s([entry(6.0), entry(12.0)])
    assert near <= far


def test_an_entry_that_is_unstable_on_the_plant_of_its_neighbour_has_no_dwell_time() -> None:
    soft, stiff = entry(4.0), entry(100.0)
    with pytest.raises(TransitionError, match="no dwell time within 60 s from entry 1 to 2"):
        dwell_time_s([soft, stiff])


def test_entries_with_another_delay_are_refused() -> None:
    with pytest.raises(TransitionError, match="differ in the drive's delay"):
        dwell_time_s([entry(6.0), entry(6.0, plant__command_delay_s=0.006)])


def test_a_change_of_the_gains_alone_keeps_the_command() -> None:
    one = entry(6.0)
    other = replace(one, gains=replace(one.gains, k_tension=0.5 * one.gains.k_tension, k_speed=0.3))
    (plant,) = one.family.members
    before, after = transitions._parts(one), transitions._parts(other)
    change = transitions._change(plant, before.opened, before.errors, before.gains, after.gains)
    state = np.random.default_rng(1).standard_normal(len(change))
    # With the errors of the last tick, the other gains ask for what the old ones asked for.
    first = len(change) - len(before.opened.a)
    errors = before.errors @ state[first:]
    kept = closed_loop(plant, before.opened).a @ state
    taken = change @ state
    old, new = before.gains, after.gains
    by_old = -old.k_tension * errors[0] - old.k_speed * errors[1] - kept[-1]
    by_new = -new.k_tension * errors[0] - new.k_speed * errors[1] - taken[-1]
    assert by_new == pytest.approx(by_old, rel=1e-12)


def test_a_filter_with_a_quiet_setting_is_proven_with_its_common_function() -> None:
    quiet = {"estimator__quiet_tension_walk_n": 0.005, "estimator__quiet_disturbance_walk_mm_s": 6.0}
    assert dwell_time_s([entry(6.0, **quiet), entry(6.6, **quiet)]) > 0.0
