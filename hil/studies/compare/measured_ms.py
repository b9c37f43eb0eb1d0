"""Ms of a loop on its simulated rig, measured there: neither the design's plant nor `rigctl`'s own response is in it.

Two multisines act on the running loop at once, on lines of their own: a speed d on what the drive takes from the bus,
and newtons e on what the cell sends. With c the loop's command as the drive receives it and y the reading as sent,

    S_input = (c + d) / d at the lines of d,    S_output = y / e at the lines of e

over whole periods, whatever the loop does: nothing of it is known here. Which lines, pass after pass, is a matter of
`hil.studies.compare.peak_search`: from 0.3 to 400 Hz, then closer, for at most 120 s a level. The uncertainty has the
scatter from period to period, 95 %, and what the lines may miss between them. It has not what is not linear: the
drive's dead band and ripple. A filter with two settings is held at a level meanwhile; at each the largest |S| is
measured. Our law runs without the loop's probe, as the rivals do: its multisine has periods in common with ours, so
that it adds to lines of ours, and ours do not average out in its judgement (it took the cell of one rig in twenty for
a frozen one).
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep, lockstep
from hil.nodes.tension_amplifier import TensionAmplifier
from hil.scenario.errors import ScenarioError
from hil.scenario.play import bring_to_target
from hil.studies.compare import peak_hints
from hil.studies.compare.local_peak import SensitivityLine
from hil.studies.compare.peak_search import PLACES, SearchPass, Span, largest
from rigctl.commission.identification import student_t
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.control.loop import LawFactory
from rigctl.devices import objects
from rigctl.model.states import Mode

Floats = npt.NDArray[np.float64]

HIGH_HZ = 400.0
SPEED_RMS_MM_S, NOISE_TIMES = 0.8, 1.0
"""Of d: well above the drive's dead band, and below every limit. Of e: so many times the cell's noise, and more at low
frequencies, where the drive's own noise is a wander of the tension. With three times the noise, the filter's gate of
five sigma rejected samples, and the loop was not linear."""
FOLLOWED_MM_S, MOST_N = 0.4, 1.0
"""Of e at low frequencies: the speed with which the rope's end follows it, and the most newtons."""
LEAST_SHARED = 40
"""Lines that share this rms at least: fewer, all of them about the largest |S|, would be stronger and meet a limit."""
LESS_NOISE = 0.1
"""Of the cell's noise is left meanwhile: a linear loop's S does not depend on it, and 100 times as many periods would
take as many hours as this does minutes. What the loop believes of its noise stays."""
SETTLING_S = 3.0
POOLED = 2
"""Lines on either side of one whose scatter counts as much as its own: two periods alone say little of it."""
_TARGET = slice(2, 6)  # of the RPDO: INTEGER32 behind the controlword


class Peak(NamedTuple):
    """The largest measured |S|, half of its 95 % interval, where, and in which setting of the filter."""

    ms: float
    error: float
    hz: float
    place: str
    """``input`` or ``output``."""
    level: float
    """0 quiet, 1 open."""

    def in_words(self) -> str:
        """Ms with its interval and frequency."""
        return f"Ms {self.ms:.3f} +- {self.error:.3f} at {self.hz:.3g} Hz"


class HeldLevel:
    """In the place of the filter's `Opening`: a level that stays."""

    def __init__(self, level: float) -> None:
        self.level = level

    def open(self) -> None:
        """Nothing opens it."""

    def look(self, _innovation_n: float) -> None:
        """No innovation does."""


def measured(
    built: RigSettings, believed: RigSettings, gains: Gains, levels: Sequence[float] = (1.0,),
    law: LawFactory | None = None, late: float = 0.0,
) -> Peak:  # fmt: skip
    """The largest |S| over both places and the levels, of the law with these gains on the rig as built.

    ``late``: every tick wakes late by 0 to so much of a period, drawn.

    Raises:
        ScenarioError: the rig does not get to COMPENSATING, or does not stay there.
    """
    ours = law is None
    if law is None:  # a loop that is given its law has no probe

        def law(settings: RigSettings, gains: Gains, _inbox: Inbox) -> TensionLaw:
            return TensionLaw(settings, gains)

    calm = changed(built, {"tension_cell.noise_n": LESS_NOISE * built.tension_cell.noise_n})
    with lockstep(believed, gains, law=law, built=calm) as rig:
        bring_to_target(rig, believed.tension.target_n, SETTLING_S)
        random, most_ns = Random(1), late * believed.loop.period_ns

        def wake_late() -> None:
            rig.clock.late_ns = round(most_ns * random.random())

        rig.on_advance = wake_late
        plants, top_hz = peak_hints.plants(built), min(HIGH_HZ, 0.45 * rig.settings.loop.rate_hz)
        found = []
        for level in levels:
            spans = peak_hints.of_mechanism(plants)
            if ours:
                law_then = peak_hints.law_at(believed, gains, level)
                spans += peak_hints.of_loop(plants, law_then, 1.0 / believed.loop.rate_hz, top_hz)
            found.append(_at_level(rig, level, spans, top_hz))
        return max(found, key=lambda peak: peak.ms)


def _at_level(rig: Lockstep, level: float, spans: Sequence[Span], top_hz: float) -> Peak:
    filtering = rig.view.filter
    if filtering.opening is not None:
        filtering.opening = HeldLevel(level)  # type: ignore[assignment]
    found = largest(lambda excitation: _pass(rig, excitation), spans, top_hz)
    return Peak(found.ms, found.error, found.hz, found.place, level)


def _pass(rig: Lockstep, excitation: SearchPass) -> list[SensitivityLine]:
    """S at the plant's input and at the tension, at these lines."""
    settings = rig.settings
    count, settle = (round(s * settings.loop.rate_hz) for s in (excitation.period_s, excitation.settle_s))
    of_drive, of_cell = (np.array(each, np.intp) for each in excitation.harmonics)
    d_mm_s = _multisine(of_drive, count, np.full(len(of_drive), SPEED_RMS_MM_S))
    e_n = _multisine(of_cell, count, _newtons(settings, of_cell / excitation.period_s))
    d = np.round(d_mm_s / objects.MM_S_PER_VELOCITY_UNIT).astype(int)
    e = np.round(e_n / objects.N_PER_CELL_UNIT).astype(int)
    total = settle + excitation.periods * count
    command, reading = np.zeros(total), np.zeros(total)
    drive, cell, tick = rig.rig.drive, rig.rig.cell, -1
    if not isinstance(cell, TensionAmplifier):
        raise ScenarioError([f"{settings.rig}: tension_cell: found plain frames, expected the CANopen amplifier"])
    put_back = cell.putting_back()

    def moved(data: bytes) -> bytes:
        sent = int.from_bytes(data[_TARGET], "little", signed=True)
        moved_by = int(d[(tick - settle) % count])
        command[tick] = sent + moved_by
        return data[: _TARGET.start] + (sent + moved_by).to_bytes(4, "little", signed=True) + data[_TARGET.stop :]

    def added(own: int) -> int:
        value = own + int(e[(tick - settle) % count])
        reading[tick] = value
        return value

    try:
        drive.rpdo_defect = moved
        cell.distort(objects.AI_PROCESS_VALUE, 1, added)
        for tick in range(total):  # noqa: B007 - the two functions above read it
            rig.tick()
    finally:
        drive.rpdo_defect = None
        put_back()
    if rig.loop.machine.mode is not Mode.COMPENSATING:
        raise ScenarioError([f"{settings.rig}: {rig.loop.machine.fault.name} while Ms was measured"], exit_code=1)
    outputs = command[settle:].reshape(-1, count), reading[settle:].reshape(-1, count)
    found = []
    for place, harmonics, acting, output in zip(PLACES, excitation.harmonics, (d, e), outputs, strict=True):
        if harmonics:
            values, errors = _with_errors(output, acting, np.array(harmonics, np.intp))
            found += [
                SensitivityLine(place, harmonic / excitation.period_s, complex(value), float(error))
                for harmonic, value, error in zip(harmonics, values, errors, strict=True)
            ]
    return found


def _with_errors(output: Floats, acting: npt.NDArray[np.int_], harmonics: npt.NDArray[np.intp]) -> tuple[Any, Floats]:
    """S at the harmonics from one row for each period, and half of the 95 % interval of its modulus."""
    periods = np.fft.rfft(output, axis=1)[:, harmonics] / np.fft.rfft(acting)[harmonics]
    mean, count = periods.mean(axis=0), len(periods)
    variance = np.sum(np.abs(periods - mean) ** 2, axis=0) / (count * (count - 1.0)) / 2.0
    pooled = min(1 + 2 * POOLED, len(harmonics))
    shares = np.ones(pooled)
    variance = np.convolve(variance, shares, "same") / np.convolve(np.ones(len(variance)), shares, "same")
    return mean, student_t(2 * (count - 1) * (pooled // 2 + 1)) * np.sqrt(variance)


def _newtons(settings: RigSettings, hz: Floats) -> Floats:
    """The rms that e would have if all of its lines were as strong as that at each of these frequencies."""
    followed = np.minimum(FOLLOWED_MM_S * settings.plant.stiffness_n_mm / (2.0 * np.pi * hz), MOST_N)
    return np.maximum(followed, NOISE_TIMES * settings.tension_cell.noise_n)


def _multisine(harmonics: npt.NDArray[np.intp], count: int, rms: Floats) -> Floats:
    """One period, with Schroeder's phases; ``rms``: of the whole, if `LEAST_SHARED` lines or more were as strong."""
    spectrum, places = np.zeros(count // 2 + 1, np.complex128), np.arange(len(harmonics))
    lines = max(1, len(harmonics))
    amplitudes = rms * np.sqrt(2.0 / max(lines, LEAST_SHARED))
    spectrum[harmonics] = 0.5 * count * amplitudes * np.exp(-1j * np.pi * places * (places - 1.0) / lines)
    return np.asarray(np.fft.irfft(spectrum, count))
