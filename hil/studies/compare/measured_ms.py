"""Ms of a loop on its simulated rig, measured there: neither the design's plant nor `rigctl`'s own response is in it.

Two multisines act on the running loop at once, on lines of their own: a speed d on what the drive takes from the bus,
and newtons e on what the cell sends. With c the loop's command as the drive receives it and y the reading as sent,

    S_input = (c + d) / d at the lines of d,    S_output = y / e at the lines of e

over whole periods, whatever the loop does: nothing of it is known here. A first pass looks from ``LOW_HZ`` to
``HIGH_HZ``, a second one closer about the highest lines of the first. The uncertainty is that of the scatter from
period to period, 95 %. A filter with two settings is held at a level meanwhile; at each the largest |S| is measured.
Our law runs without the loop's probe, as the rivals do: its multisine has the same period, so that it adds to lines of
ours, and ours do not average out in its judgement (it took the cell of one rig in twenty for a frozen one).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep, lockstep
from hil.nodes.tension_amplifier import TensionAmplifier
from hil.scenario.errors import ScenarioError
from hil.scenario.play import bring_to_target
from rigctl.commission.identification import student_t
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.control.loop import LawFactory
from rigctl.devices import objects
from rigctl.model.states import Mode

Lines = npt.NDArray[np.intp]
Floats = npt.NDArray[np.float64]

PERIOD_S, PERIODS, SETTLE_S = 2.0, 4, 2.0
LOW_HZ, HIGH_HZ, FIRST_LINES = 1.5, 400.0, 36
CLOSER, CLOSER_LINES = 1.3, 14
"""The second pass goes from the frequency of the first one's peak over this factor to that times it."""
SPEED_RMS_MM_S, NOISE_TIMES = 0.8, 3.0
"""Of d: well above the drive's dead band, and below every limit. Of e: so many times the cell's noise."""
LESS_NOISE = 0.1
"""Of the cell's noise is left meanwhile: a linear loop's S does not depend on it, and 100 times as many periods would
take as many hours as this does minutes. What the loop believes of its noise stays."""
PLACES = "input", "output"
SETTLING_S = 3.0
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
        return max((_at_level(rig, level) for level in levels), key=lambda peak: peak.ms)


def _at_level(rig: Lockstep, level: float) -> Peak:
    filtering = rig.view.filter
    if filtering.opening is not None:
        filtering.opening = HeldLevel(level)  # type: ignore[assignment]
    count = round(PERIOD_S * rig.settings.loop.rate_hz)
    top_hz = min(HIGH_HZ, 0.45 * rig.settings.loop.rate_hz)
    wide = _apart(np.geomspace(LOW_HZ, top_hz, 2 * FIRST_LINES))
    found = _pass(rig, wide[::2], wide[1::2], count)
    highest = (max((peak for peak in found if peak.place == place), key=lambda peak: peak.ms) for place in PLACES)
    near = [_apart(np.geomspace(at.hz / CLOSER, min(at.hz * CLOSER, top_hz), CLOSER_LINES)) for at in highest]
    of_drive = near[0]
    of_cell = np.setdiff1d(near[1] + np.isin(near[1], of_drive), of_drive)
    found += _pass(rig, of_drive, of_cell, count)
    return max(found, key=lambda peak: peak.ms)._replace(level=level)


def _apart(hz: Floats) -> Lines:
    """Harmonics of the period, each once."""
    return np.unique(np.maximum(1, np.round(hz * PERIOD_S))).astype(np.intp)


def _pass(rig: Lockstep, of_drive: Lines, of_cell: Lines, count: int) -> list[Peak]:
    """|S| at the plant's input and at the tension, at these lines."""
    settings = rig.settings
    d = np.round(_multisine(of_drive, count, SPEED_RMS_MM_S) / objects.MM_S_PER_VELOCITY_UNIT).astype(int)
    noise_n = NOISE_TIMES * settings.tension_cell.noise_n
    e = np.round(_multisine(of_cell, count, noise_n) / objects.N_PER_CELL_UNIT).astype(int)
    settle = math.ceil(SETTLE_S / PERIOD_S) * count
    total = settle + PERIODS * count
    command, reading = np.zeros(total), np.zeros(total)
    drive, cell, tick = rig.rig.drive, rig.rig.cell, -1
    if not isinstance(cell, TensionAmplifier):
        raise ScenarioError([f"{settings.rig}: tension_cell: found plain frames, expected the CANopen amplifier"])
    put_back = cell.putting_back()

    def moved(data: bytes) -> bytes:
        sent = int.from_bytes(data[_TARGET], "little", signed=True)
        command[tick] = sent
        return (
            data[: _TARGET.start]
            + (sent + int(d[tick % count])).to_bytes(4, "little", signed=True)
            + data[_TARGET.stop :]
        )

    def added(own: int) -> int:
        value = own + int(e[tick % count])
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
    found = []
    for place, where, input_, output in (
        (PLACES[0], of_drive, d, command + np.tile(d, total // count)), (PLACES[1], of_cell, e, reading)
    ):  # fmt: skip
        source = np.fft.rfft(input_)[where]
        periods = np.fft.rfft(output[settle:].reshape(PERIODS, count), axis=1)[:, where] / source
        mean = periods.mean(axis=0)
        spread = np.sqrt(np.sum(np.abs(periods - mean) ** 2, axis=0) / (PERIODS * (PERIODS - 1.0)) / 2.0)
        errors = student_t(2 * (PERIODS - 1)) * spread
        found += [
            Peak(abs(complex(value)), float(error), float(line / PERIOD_S), place, 1.0)
            for value, error, line in zip(mean, errors, where, strict=True)
        ]
    return found


def _multisine(lines: Lines, count: int, rms: float) -> Floats:
    """Equal amplitudes with Schroeder's phases."""
    places = np.arange(len(lines))
    spectrum = np.zeros(count // 2 + 1, np.complex128)
    spectrum[lines] = np.exp(-1j * np.pi * places * (places - 1.0) / len(lines))
    wave = np.fft.irfft(spectrum, count)
    return np.asarray(wave * rms / np.sqrt(np.mean(wave**2)))
