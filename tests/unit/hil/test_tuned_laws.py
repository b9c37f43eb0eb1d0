"""Rivals tuned by the optimiser of our law, random rigs, and the rows that a long study keeps."""

from __future__ import annotations

import math
import pathlib
import warnings
from typing import Any

import numpy as np
import pytest

from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from hil.studies.compare import equal_limits, front, identification, law_robustness, tuned_laws
from hil.studies.compare.equal_limits import COMPARED, Known, our_design, tuning
from hil.studies.compare.law_robustness import robustness
from hil.studies.compare.random_rigs import RigRow, drawn, summary
from hil.studies.compare.rivals import LAWS, OURS
from hil.studies.compare.rivals.feedback import Model
from hil.studies.compare.rivals.tunable import TUNABLE
from hil.studies.compare.tuned_laws import STARTS, FamilyResponses, TunedLaw, from_lqi, judged, knobs_of, tuned
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design import identified, plant_family
from rigctl.design.knobs import knobs_for, value_of
from rigctl.design.margins import design_and_check
from rigctl.design.optimise import OurDesign
from rigctl.design.plant_family import Family
from tests.builders.rig_bench import SETTINGS

RIG = SETTINGS


@pytest.mark.parametrize("law", ["pi", "lqi", "pi_dob"])
def test_a_published_law_is_judged_as_in_the_comparison(law: str) -> None:
    make = LAWS[law].make
    assert make is not None
    family = Family("assumed", tuple(plant_family.family(RIG)))
    found = judged(RIG, lambda: make(RIG), FamilyResponses(RIG, family))
    expected = robustness(RIG, LAWS[law])
    assert found is not None
    assert expected is not None
    if math.isfinite(expected.ms_family):
        assert found.ms == pytest.approx(expected.ms_family, rel=0.01)
    assert found.command_noise_mm_s == pytest.approx(expected.command_noise_mm_s, rel=0.02)


@pytest.mark.parametrize("law", list(TUNABLE))
def test_every_rival_has_a_value_in_range_for_each_of_its_parameters(law: str) -> None:
    tunable = TUNABLE[law]
    start = tunable.start(Model.of(RIG))
    assert len(start) == len(tunable.knobs)
    assert all(knob.low <= value <= knob.high for knob, value in zip(tunable.knobs, start, strict=True))
    tunable.make(RIG, start)


def test_an_optimised_rival_keeps_the_limits_that_ours_keeps_and_errs_less_than_its_start() -> None:
    known = Known.of(RIG)
    found = tuned(known.settings, known.family, "pi", (0.08, 8.0), evaluations=12)
    assert found.within
    assert found.ms <= RIG.design.ms_max
    assert found.command_noise_mm_s <= RIG.design.command_noise_max_mm_s
    assert found.cost < tuned(known.settings, known.family, "pi", (0.08, 8.0), evaluations=1).cost
    quiet = changed(known.settings, {"design.command_noise_max_mm_s": 0.05})
    assert tuned(quiet, known.family, "pi", (0.08, 8.0), evaluations=12).command_noise_mm_s <= 0.05


def test_each_law_is_searched_from_three_starts_of_which_the_best_is_kept() -> None:
    known = Known.of(RIG)
    far = (0.9, 90.0)  # an error of seconds: the simplex does not come back in so few steps
    found = tuned(known.settings, known.family, "pi", far, evaluations=4)
    assert len(found.costs) == STARTS
    assert found.cost == min(found.costs)
    assert found.cost < found.costs[0]
    assert found.spread_pct == pytest.approx(100.0 * (math.exp(max(found.costs) - found.cost) - 1.0))
    assert found == tuned(known.settings, known.family, "pi", far, evaluations=4)  # starts follow from the seed
    whole = tuned(known.settings, known.family, "p", evaluations=2)
    assert len(set(whole.costs)) > 1


def test_the_spread_of_starts_is_none_where_one_found_nothing() -> None:
    law = TunedLaw("pi", (0.05, 4.0), True, -2.0, 1.5, 0.1, (-2.0, math.inf, -1.9))
    assert law.spread_pct is None
    assert equal_limits.spread_in_words(law) == "of which 1 found nothing within the limits"
    law = law._replace(costs=(-2.0, -2.0 + math.log(1.05), -2.0))
    assert law.spread_pct == pytest.approx(5.0)
    assert equal_limits.spread_in_words(law) == "within 5.0 %"


@pytest.mark.parametrize("values", [(0.05, 0.1, 10.0), (0.05, 0.5, 2.0), (0.2, 0.1, 10.0)])
def test_our_law_holds_lqi_whose_optimum_is_a_start_of_its_search(values: tuple[float, float, float]) -> None:
    """Where the loop works: below, LQI integrates the reading and ours the estimate, and ours has a slow walk left."""
    known = Known.of(RIG)
    z = np.exp(2j * np.pi * np.geomspace(3.0, 100.0, 9) / RIG.loop.rate_hz)
    theirs = law_robustness.response(TUNABLE["lqi"].make(known.settings, values), z, 6000)
    used, made = our_design(known, from_lqi(known.settings, values))
    ours = OurDesign(used, made).response
    assert ours is not None
    np.testing.assert_allclose(np.abs(ours(z) / theirs), 1.0, atol=0.03)


def test_the_search_of_our_law_begins_at_the_optimum_of_lqi_too(monkeypatch: pytest.MonkeyPatch) -> None:
    known, begun = Known.of(RIG), list[tuple[float, ...]]()
    best = TunedLaw("lqi", (0.05, 0.5, 2.0), True, 0.0, 1.5, 0.1)

    def ours(settings: RigSettings, *_: object) -> TunedLaw:
        begun.append(tuple(value_of(settings, knob.key) for knob in knobs_for(settings)))
        return best

    monkeypatch.setattr(tuned_laws, "_rival", lambda *_: best)
    monkeypatch.setattr(tuned_laws, "_ours", ours)
    tuning(known, OURS, RowsFile(None, {}))
    assert len(begun) == STARTS
    assert begun[-1] == from_lqi(known.settings, best.values)


def test_a_law_that_is_unstable_on_its_own_plant_is_beyond_every_limit() -> None:
    known = Known.of(RIG)
    plants = FamilyResponses(known.settings, known.family)
    found = judged(known.settings, lambda: TUNABLE["p"].make(known.settings, (3.0,)), plants)
    assert found is None or found.ms > RIG.design.ms_max


def test_a_loop_that_grows_beyond_every_number_does_not_die_out_and_prints_nothing() -> None:
    own, feedback = plant_family.family(RIG)[0], TUNABLE["p"].make(RIG, (1e6,))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not law_robustness.dies_out(own, feedback, 2000)


def test_what_is_known_exactly_is_the_rig_as_built() -> None:
    rig = changed(RIG, {"simulation.stiffness_scale": 1.3, "simulation.mechanism.vertical_n_mm": 60.0,
                        "simulation.delay_scale": 2.0})  # fmt: skip
    found = identification.exact(rig)
    assert found.stiffness_n_mm.value == pytest.approx(1.3 * RIG.plant.stiffness_n_mm)
    assert found.delay_s.value == pytest.approx(0.004), "the cell's filter is no delay of the drive"
    assert found.mechanism_n_mm is not None
    rigid = identification.exact(changed(RIG, {"simulation.mechanism.vertical_n_mm": 5000.0}))
    assert rigid.mechanism_n_mm is None
    assert rigid.mechanism_above_n_mm is not None
    assert rigid.mechanism_above_n_mm < 5000.0


@pytest.mark.study
def test_what_is_played_finds_the_rig_as_built_within_what_it_states() -> None:
    rig = drawn(RIG, 1, 0)
    found, truth = identification.played(rig), identification.built(rig)
    assert found.damping_n_s_mm is not None
    for name in ("stiffness_n_mm", "lag_s", "delay_s", "damping_n_s_mm"):
        figure = getattr(found, name)
        assert abs(figure.value - getattr(truth, name)) <= 2.0 * figure.error, name


def test_a_random_rig_follows_from_its_seed_and_is_within_the_stated_ranges() -> None:
    for index in range(40):
        rig = drawn(RIG, 3, index)
        assert rig == drawn(RIG, 3, index)
        truth = identification.built(rig)
        assert 4.0 <= truth.stiffness_n_mm <= 40.0
        assert 0.7 <= truth.lag_s / RIG.plant.cylinder_lag_s <= 1.3
        assert abs(truth.delay_s - identification.built(RIG).delay_s) <= 0.002
        assert truth.mechanism_n_mm is None or 6.0 <= truth.mechanism_n_mm <= 3000.0
    assert drawn(RIG, 3, 0) != drawn(RIG, 4, 0)


def test_the_family_about_an_identified_rig_holds_the_true_plant() -> None:
    rig = changed(RIG, {"simulation.stiffness_scale": 0.9, "simulation.lag_scale": 1.3})
    known = Known.of(rig)
    truth = identification.true_plant(rig)
    ms = design_and_check(known.settings, Family("true", (truth,))).ms_max
    assert ms <= design_and_check(known.settings, known.family).ms_max
    assert identified.widened(known.plant, known.settings)["lag_s"].low < 0.026


def test_medians_and_worst_cases_count_rigs_that_ended_early_or_are_beyond_the_limit() -> None:
    rows = [
        RigRow(0, OURS, 6.0, None, 1.61, 0.02, 60.0, 1.0, 1.5, 0.01, 0.002, 20.0, "COMPENSATING"),
        RigRow(1, OURS, 6.0, None, 1.65, 0.02, 60.0, 0.0, 1.5, 0.03, 0.004, 40.0, "COMPENSATING"),
        RigRow(2, OURS, 6.0, None, None, None, None, None, 1.5, None, None, None, "tripped: X at 1.0 s"),
    ]
    said = summary(rows, 1.6)[OURS]
    assert (said["rigs"], said["ended_early"]) == (3, 1)
    assert said["ms_above"] == 2, "1.61 +- 0.02 is not surely above; a rig without a figure counts"
    assert (said["eta_max_pct"]["median"], said["eta_max_pct"]["worst"]) == (0.02, 0.03)


def test_residual_acceleration_is_the_error_over_the_payload() -> None:
    # 0.01 % of 300 N on 30 kg is 1 mm/s^2, 102 millionths of g.
    assert equal_limits.micro_g(RIG, 0.01) == pytest.approx(1e6 * 1e-3 / 9.80665)


def test_rows_are_kept_and_those_of_another_study_are_refused(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "rows.jsonl"
    RowsFile(file, {"rig": "a", "seed": 1}).put("one", {"x": 1.5})
    again = RowsFile(file, {"rig": "a", "seed": 1})
    assert again.get("one") == {"x": 1.5}
    assert again.get("two") is None
    with pytest.raises(ScenarioError, match=r"rows.jsonl: its rows are of another study \(seed differs\)"):
        RowsFile(file, {"rig": "a", "seed": 2})
    file.write_text("nonsense\n")
    with pytest.raises(ScenarioError, match="found no rows of a study"):
        RowsFile(file, {"rig": "a", "seed": 1})


def test_a_tuning_on_record_is_not_searched_again(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, known = RowsFile(tmp_path / "rows.jsonl", {}), Known.of(RIG)
    asked: list[Any] = []

    def search(*arguments: Any, **_options: Any) -> TunedLaw:
        asked.append(arguments)
        return TunedLaw("pi", (0.05, 4.0), len(asked) > 1, math.inf, 1.5, 0.1, (math.inf, -2.0, -1.9))

    monkeypatch.setattr(equal_limits, "tuned", search)
    base = TunedLaw("pi", (0.04, 4.0), True, 0.0, 1.5, 0.1)
    assert tuning(known, "pi", rows, base).within
    assert [call[3:] for call in asked] == [((0.04, 4.0),), ()]  # nothing near the start, so the whole range
    kept = tuning(known, "pi", rows, base)
    assert kept.values == (0.05, 4.0)
    assert kept.costs == (math.inf, -2.0, -1.9)
    assert len(asked) == 2


def test_the_front_shows_a_law_as_it_is_beyond_any_limit() -> None:
    point = front.as_it_is(Known.of(RIG), "pi")
    assert point.ms > 1.6
    assert point.share is not None
    assert point.limit is None
    assert set(COMPARED) == {*TUNABLE, OURS}
    assert len(knobs_of(OURS, RIG)) >= 5


def test_the_picture_of_the_front_is_drawn(tmp_path: pathlib.Path) -> None:
    points = [
        front.FrontPoint("pi", 1.4, 1.39, 0.2, 0.1), front.FrontPoint("pi", 1.6, 1.59, 0.15, 0.2),
        front.FrontPoint("pi", None, 2.0, 0.14, 0.2), front.FrontPoint(OURS, 1.6, 1.59, 0.1, 0.4),
        front.FrontPoint(OURS, 1.3, math.inf, None, 0.4),
    ]  # fmt: skip
    front.draw(RIG, points, tmp_path / "front.svg")
    assert "Ms over the family" in (tmp_path / "front.svg").read_text()
