"""The study of `python -m hil compare --bound`: our law against the least error that any linear law reaches.

Nominal plant against nominal plant: the plant in the settings after identification, the cell and the drive's speed as
sensors, Ms and noise within the limits of the file. Ours has one setting of its filter, with which it is linear, and is
tuned twice, for that plant alone and over the family of the identified one; the second over the first is the price of
the family.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from hil.runs.rows_file import RowsFile
from hil.scenario.play import play
from hil.studies.compare.bound import program
from hil.studies.compare.bound.linear_law import Disturbance, Inclination, Tone, law_of
from hil.studies.compare.bound.nominal import JOLT, MOVE_MEMORY_S, TONES, Nominal
from hil.studies.compare.bound.program import SIGMAS, Case
from hil.studies.compare.compared_runs import STEADY_S, ComparedRun
from hil.studies.compare.comparison import WAIVER
from hil.studies.compare.equal_limits import Known, LoopLaw, loop_law, played, tuning
from hil.studies.compare.rivals import OURS
from hil.studies.compare.tuned_laws import TunedLaw
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.design import plant_family, surrogate
from rigctl.design.gains import OPEN
from rigctl.design.margins import controllers
from rigctl.design.plant_family import Array, Family
from rigctl.design.surrogate import OurLaw

OURS_MEMORY_S = 4.0
JOINT, MOVE = "joint", "paper_k"
TOLERANCE = 1e-3
"""Of the bound, below which ours is not: knots and solver."""
Say = Callable[[str], None]


class Ours(NamedTuple):
    """Our law on the nominal plant; errors in N."""

    rms_n: float
    largest_n: float
    """With `SIGMAS` of the noise."""
    ms: float
    command_noise_mm_s: float


class BoundRow(NamedTuple):
    """A disturbance on one plant; errors in N, None where there is no such figure."""

    name: str
    bound_rms_n: float
    bound_largest_n: float | None
    aided_rms_n: float | None
    """The bound with the inclination as a second sensor."""
    aided_largest_n: float | None
    alone: Ours
    """Tuned for this plant alone."""
    family: Ours
    """Tuned over the family."""
    played_rms_n: float | None
    """Tuned over the family, in the real loop on the simulated rig, with its inclination."""
    played_largest_n: float | None

    @property
    def below(self) -> bool:
        """Ours is below the bound: then the bound is wrong.

        Not of a sine: its bound is that of a law that remembers 100 ms, and ours remembers more.
        """
        least = (1.0 - TOLERANCE) * self.bound_rms_n
        return self.name not in TONES and min(self.alone.rms_n, self.family.rms_n) < least


class Joint(NamedTuple):
    """Least share of our errors to which one law can bring all of heave, shakes and jolt at once."""

    alone: float
    family: float


def names(runs: Sequence[ComparedRun]) -> list[str]:
    """The rows there are."""
    return [*(run.name for run in runs if run.name.startswith(MOVE)), *TONES, JOLT, JOINT]


def study(
    rig: RigSettings, runs: Sequence[ComparedRun], only: Sequence[str], rows: RowsFile, say: Say, designs: int | None
) -> tuple[list[BoundRow], Joint | None]:
    """Every row of ``only``; what ``rows`` has already is not done again.

    Raises:
        NoBoundError: no law keeps the limits on a plant.
        ScenarioError: the rig cannot be simulated.
    """
    known = Known.of(rig)
    bases = _tuned(known, rows, None, designs)
    say(f"ours for the rig of the file: Ms {bases[0].ms:.2f} alone, {bases[1].ms:.2f} over the family")
    found = []
    for name in (name for name in names(runs) if name in only and name != JOINT):
        kept = rows.get(f"bound {name}")
        if kept is None:
            run = next(run for run in runs if run.name == name)
            if name.startswith(MOVE):
                there = Known.of(run.settings(rig, WAIVER))
                row = NominalPlant(there, _tuned(there, rows, bases, designs)).move(rig, run, name)
            else:
                row = NominalPlant(known, bases).row(name)
            kept = rows.put(f"bound {name}", row._asdict())
        row = BoundRow(**{**kept, "alone": Ours(*kept["alone"]), "family": Ours(*kept["family"])})
        found.append(row)
        say(f"{name}: bound {row.bound_rms_n:.5f} N, ours {row.alone.rms_n:.5f} N alone, {row.family.rms_n:.5f} N")
    if JOINT not in only:
        return found, None
    kept = rows.get(f"bound {JOINT}") or rows.put(f"bound {JOINT}", NominalPlant(known, bases).joint()._asdict())
    return found, Joint(**kept)


def _tuned(
    known: Known, rows: RowsFile, bases: tuple[TunedLaw, TunedLaw] | None, designs: int | None
) -> tuple[TunedLaw, TunedLaw]:
    """Ours for the nominal plant alone, and over the family."""
    single = known._replace(family=Family("nominal", (plant_family.nominal(known.settings),)))

    def linear(known: Known, base: TunedLaw | None, name: str) -> TunedLaw:
        return tuning(known, OURS, rows, base, name, designs, linear=True)

    family = linear(known, bases[1] if bases else None, "ours, one setting")
    return linear(single, bases[0] if bases else family, "ours alone, one setting"), family


class NominalPlant(Nominal):
    """One nominal plant with our two laws."""

    def __init__(self, known: Known, laws: tuple[TunedLaw, TunedLaw]) -> None:
        super().__init__(known.settings)
        self.loops = [loop_law(known, law) for law in laws]

    def ours(self, case: Case) -> tuple[Ours, Ours]:
        """Both of ours."""
        alone, family = (self._linear(loop, case) for loop in self.loops)
        return alone, family

    def _linear(self, loop: LoopLaw, case: Case) -> Ours:
        law = controllers(filter_model(loop.settings), loop.gains)[OPEN]
        x = law_of(self.plant, law, round(OURS_MEMORY_S * self.rate_hz))
        errors, (noise, _) = program.errors(self.short, case, x), program.command_noise(self.short, x)
        return Ours(errors.rms_n, errors.largest_n + SIGMAS * errors.noise_n, program.peak(self.short, x), noise)

    def row(self, name: str) -> BoundRow:
        """Of a sine, or of the jolt."""
        if name == JOLT:
            alone, family = self._jolted()
            return BoundRow(name, self.least_jolt(self.jolt()), None, None, None, alone, family, None, None)
        tone = self.tone(name)
        alone, family = self.ours(tone)
        return BoundRow(name, program.least(self.short, tone).value, None, None, None, alone, family, None, None)

    def joint(self) -> Joint:
        """One linear law for the sines; the jolt's own bound is for any law, and so for that one."""
        tones = [self.tone(name) for name in TONES]
        reached = zip(*([one.rms_n for one in self.ours(tone)] for tone in tones), strict=True)
        least_jolt = self.least_jolt(self.jolt())
        alone, family = (
            max(program.least_share(self.short, tones, list(ours)).value, least_jolt / jolted.rms_n)
            for ours, jolted in zip(reached, self._jolted(), strict=True)
        )
        return Joint(alone, family)

    def move(self, rig: RigSettings, run: ComparedRun, name: str) -> BoundRow:
        """Of a move; its stretch is that of the simulated rig, and so is the last figure."""
        settings = run.settings(rig, WAIVER)
        truth = play(
            settings, run.tracks, seconds=run.seconds, controller="locked", target_n=settings.tension.target_n
        ).truth[:-1]  # fmt: skip
        angles = np.stack([truth["tangential_rad"], truth["normal_rad"]])
        first, length_mm = round(STEADY_S * self.rate_hz), settings.plant.rope_length_mm
        stretch_mm = _stretch_mm(angles, length_mm)
        speed = np.diff(stretch_mm, append=stretch_mm[-1]) * self.rate_hz
        cell = Disturbance.of(self.plant, speed, first)
        aided = replace(cell, seen=_seen(settings, angles, first))
        task = self.task(MOVE_MEMORY_S)
        got = played(settings, self.loops[1], run)
        newtons = 0.01 * settings.tension.target_n
        alone, family = self.ours(cell)
        return BoundRow(
            name,
            program.least(task, cell).value,
            program.least_largest(task, cell).value,
            program.least(task, aided).value,
            program.least_largest(task, aided).value,
            alone,
            family,
            None if got.eta_rms_pct is None else newtons * got.eta_rms_pct,
            None if got.eta_max_pct is None else newtons * got.eta_max_pct,
        )

    def _jolted(self) -> tuple[Ours, Ours]:
        """Both of ours in real ticks, as they reach the limits of speed and acceleration."""

        def of(loop: LoopLaw) -> Ours:
            case = surrogate.play(loop.settings, OurLaw(loop.settings, loop.gains), self.plant, self.jolt_case())
            rest = self._linear(loop, Tone(1.0 + 0.0j, 0.0j, 0.0j))
            return rest._replace(rms_n=case.rms_n, largest_n=case.peak_n)

        return of(self.loops[0]), of(self.loops[1])


def _stretch_mm(angles_rad: Array, length_mm: float) -> Array:
    """``L (1 / cos - 1)`` of tangential and normal angle, shape (2, ticks)."""
    found: Array = length_mm * (1.0 / np.cos(angles_rad).prod(axis=0) - 1.0)
    return found


def _seen(settings: RigSettings, angles_rad: Array, first: int) -> Inclination:
    """The stretch by the inclinometer of the simulated rig: its low-pass, rate, noise and resolution.

    What its compensation of accelerations gets wrong is left out, which leaves the bound on the safe side.
    """
    assert settings.simulation is not None  # the command refuses a rig without it
    sensor, rate_hz = settings.simulation.inclinometer, settings.loop.rate_hz
    keep = math.exp(-2.0 * math.pi * sensor.filter_hz / rate_hz)
    filtered = lfilter([1.0 - keep], [1.0, -keep], angles_rad, axis=1, zi=keep * angles_rad[:, :1])[0]
    held = round(rate_hz / settings.inclinometer.rate_hz)
    at = np.arange(angles_rad.shape[1]) // held * held
    sample_rad = math.radians(math.hypot(sensor.noise_deg, sensor.quantum_deg / math.sqrt(12.0)))
    slope_rms = float(np.sqrt(np.mean(np.sum(angles_rad[:, first:] ** 2, axis=0))))
    length_mm = settings.plant.rope_length_mm
    return Inclination(_stretch_mm(filtered[:, at], length_mm), length_mm * slope_rms * sample_rad, held)


def document(rig: RigSettings, rows: Sequence[BoundRow], joint: Joint | None) -> dict[str, Any]:
    """Everything that is printed, for JSON; errors in % of the target."""
    pct = 100.0 / rig.tension.target_n
    return {
        "limits": {"ms": rig.design.ms_max, "command_noise_mm_s": rig.design.command_noise_max_mm_s},
        "rows": {
            row.name: {
                **{
                    name.replace("_n", "_pct"): value and pct * value
                    for name, value in row._asdict().items() if name not in ("name", "alone", "family")
                },
                "ours_alone": _ours(row.alone, row.bound_rms_n, pct),
                "ours_family": _ours(row.family, row.bound_rms_n, pct),
                "price_of_the_family": row.family.rms_n / row.alone.rms_n,
            }
            for row in rows
        },
        "joint": None if joint is None else {name: 1.0 / share for name, share in joint._asdict().items()},
    }  # fmt: skip


def _ours(ours: Ours, bound_n: float, pct: float) -> dict[str, float]:
    return {
        "rms_pct": pct * ours.rms_n, "max_pct": pct * ours.largest_n, "ms": ours.ms,
        "command_noise_mm_s": ours.command_noise_mm_s, "over_bound": ours.rms_n / bound_n,
    }  # fmt: skip
