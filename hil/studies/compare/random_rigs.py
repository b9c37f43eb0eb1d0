"""Random rigs: drawn by seed, identified, designed for, played, and held against their true plants.

What is drawn, each by itself: stiffness 4 to 40 N/mm and the mechanism's K_m from 6 N/mm to rigid, both uniform in the
logarithm; drive's lag +-30 %, delay +-2 ms, friction of rail and pulley and the cell's noise from half to twice those
of the rig file. The rig file believes the stiffness within 10 % and the rest as it stands; the identification corrects
it. Ms of the result is measured on the rig as it runs (`hil.studies.compare.measured_ms`): with our law in the filter's
quiet and open setting and at the level which the design has found worst. No model of the design is in that figure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.plant.layout import MECHANISM
from hil.runs import runner
from hil.runs.rows_file import RowsFile
from hil.runs.runner import Work
from hil.scenario.errors import ScenarioError
from hil.studies.compare import identification
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.equal_limits import Known, LoopLaw, loop_law, peak_of, plain, played, tuning
from hil.studies.compare.rivals import OURS
from hil.studies.compare.tuned_laws import TunedLaw
from hil.studies.planned_run import RAMP_S, SPEED_DEG_S, onwards
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.margins import design_and_check

STIFFNESS_N_MM, MECHANISM_N_MM = (4.0, 40.0), (6.0, 3000.0)
RIGID_SHARE = 0.25
BELIEVED_PCT, LAG_PCT, DELAY_S, TWICE = 10.0, 30.0, 0.002, 2.0
MOVE_S = 10.0
ASSUMED = "ours_assumed"
"""Our law without an identification: the rig file's plant and weights, over the assumed family."""
DEFAULT_LAWS = (OURS, ASSUMED)
Say = Callable[[str], None]


class RigRow(NamedTuple):
    """A law on one rig."""

    rig: int
    law: str
    stiffness_n_mm: float
    mechanism_n_mm: float | None
    ms: float | None
    """Measured on the rig; None where it did not stay in COMPENSATING."""
    ms_error: float | None
    """Half of its 95 % interval."""
    ms_hz: float | None
    ms_level: float | None
    """At which it was the largest: 0 quiet, 1 open."""
    ms_family: float | None
    """By the design, over the family of what was identified."""
    eta_max_pct: float | None
    eta_rms_pct: float | None
    micro_g: float | None
    ended: str


def drawn(rig: RigSettings, seed: int, index: int) -> RigSettings:
    """The rig of an index."""
    rng = np.random.default_rng([seed, index])
    simulation = rig.simulation
    assert simulation is not None  # the command refuses a rig without it

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    stiffness, mechanism = between(*STIFFNESS_N_MM), between(*MECHANISM_N_MM)
    rigid = bool(rng.random() < RIGID_SHARE)
    scale = 1.0 + 0.01 * BELIEVED_PCT * float(rng.uniform(-1.0, 1.0))
    believed = stiffness / scale
    friction = between(1.0 / TWICE, TWICE)
    rubbing = {
        f"simulation.{name}.{key}": friction * getattr(getattr(simulation, name), key)
        for name in ("rail", "pulley")
        for key in ("friction_static", "friction_dynamic")
    }
    noise = between(1.0 / TWICE, TWICE)
    values: Mapping[str, object] = {
        "plant.spring_n_mm": 1.0 / (1.0 / believed - 1.0 / rig.plant.rope_n_mm),
        "simulation.stiffness_scale": scale,
        "simulation.lag_scale": 1.0 + 0.01 * LAG_PCT * float(rng.uniform(-1.0, 1.0)),
        "simulation.delay_scale": max(0.0, 1.0 + DELAY_S / rig.plant.command_delay_s * float(rng.uniform(-1.0, 1.0))),
        "simulation.mechanism.vertical_n_mm": None if rigid else mechanism,
        "simulation.seed": index,
        "tension_cell.noise_n": noise * rig.tension_cell.noise_n,
        **rubbing,
    }
    return changed(rig, values)


def scenario() -> ComparedRun:
    """The paper's move with its break of the friction; the figures are of it."""
    return ComparedRun(
        name="random", title="paper move", tracks={MECHANISM: onwards(SPEED_DEG_S, MOVE_S)}, seconds=MOVE_S,
        from_s=RAMP_S,
    )  # fmt: skip


def study(
    rig: RigSettings, count: int, seed: int, laws: Sequence[str], rows: RowsFile, say: Say,
    designs: int | None = None,
) -> list[RigRow]:  # fmt: skip
    """Every law on every rig; what ``rows`` has already is not done again.

    ``designs``: for each knob and start, None for the default.

    Raises:
        ScenarioError: a rig cannot be simulated.
    """
    bases = {law: tuning(Known.of(rig), law, rows, designs=designs) for law in laws if law != ASSUMED}
    keys = {(index, law): f"rig {index} {law}" for index in range(count) for law in laws}
    missing = {
        (index, law): Work(row_of, (rig, seed, index, law, bases.get(law), designs), key)
        for (index, law), key in keys.items()
        if rows.get(key) is None
    }

    def keep(key: tuple[int, str], row: RigRow) -> None:
        rows.put(keys[key], row._asdict())
        say(_words(row))

    runner.play(missing, lambda _cost, _title: None, keep=keep)
    return [RigRow(**rows.get(key)) for key in keys.values()]


def row_of(
    rig: RigSettings, seed: int, index: int, law: str, base: TunedLaw | None, designs: int | None
) -> RigRow:  # fmt: skip
    """A law on one rig: tuned for what was identified, Ms measured, the move played."""
    settings = drawn(rig, seed, index)
    if law == ASSUMED:
        designed = design_and_check(settings)
        runs, family = LoopLaw(settings, designed.gains), designed.ms_max
    else:
        try:
            known = Known.of(settings, identification.played(settings))
        except ScenarioError as error:
            if error.exit_code != 1:
                raise
            return RigRow(index, law, *_built(settings), *(None,) * 8, str(error))
        mine = tuning(known, law, RowsFile(None, {}), base, designs=designs)
        runs, family = loop_law(known, mine), mine.ms
    peak = peak_of(settings, runs)
    outcome = played(settings, runs, scenario())
    found: tuple[float | None, float | None, float | None, float | None] = None, None, None, None
    if peak is not None:
        found = peak.ms, peak.error, peak.hz, peak.level
    return RigRow(
        index, law, *_built(settings), *found, plain(family), outcome.eta_max_pct, outcome.eta_rms_pct, outcome.micro_g,
        outcome.ended,
    )  # fmt: skip


def _built(settings: RigSettings) -> tuple[float, float | None]:
    plant = identification.built(settings)
    return plant.stiffness_n_mm, plant.mechanism_n_mm


def summary(rows: Sequence[RigRow], ms_max: float) -> dict[str, dict[str, Any]]:
    """Per law: trips and the like, rigs whose measured Ms is above the limit beyond its interval, medians, worst."""
    return {law: _of_law([row for row in rows if row.law == law], ms_max) for law in dict.fromkeys(r.law for r in rows)}


def _of_law(rows: Sequence[RigRow], ms_max: float) -> dict[str, Any]:
    said: dict[str, Any] = {
        "rigs": len(rows),
        "ended_early": sum(row.eta_rms_pct is None for row in rows),
        "ms_above": sum(row.ms is None or row.ms_error is None or row.ms - row.ms_error > ms_max for row in rows),
    }
    for name in ("ms", "eta_max_pct", "eta_rms_pct", "micro_g"):
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        said[name] = {
            "median": float(np.median(values)) if values else None,
            "p95": float(np.percentile(values, 95.0)) if values else None,
            "worst": max(values, default=None),
        }
    return said


def _words(row: RigRow) -> str:
    ms = "Ms not measured" if row.ms is None else f"Ms {row.ms:.3f} +- {row.ms_error:.3f} at {row.ms_hz:.3g} Hz"
    errors = row.ended if row.eta_rms_pct is None else f"max {row.eta_max_pct:.4f}, rms {row.eta_rms_pct:.4f} %"
    return f"rig {row.rig}, {row.law}: k {row.stiffness_n_mm:.1f} N/mm, {ms}, {errors}"
