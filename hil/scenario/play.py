"""One run: the real loop in lockstep, or the plant alone with its cylinder locked."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import CommandRefusedError, arm_and_tension
from hil.plant import Plant
from hil.plant.inputs import Track
from hil.scenario.errors import ScenarioError
from hil.truth import TRUTH_DTYPE
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.loop import LawFactory
from rigctl.design.gains import DesignError
from rigctl.design.in_use import adopted, design_in_use
from rigctl.design.verdict import Design
from rigctl.ipc.correction import Correction
from rigctl.ipc.runtime_folder import RoomError
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

LOCKED_PERIOD_NS = 1_000_000
PREPARING = "preparing the plant (compiled once)"
CHUNK_S = 0.25
"""Simulated time between two updates of the progress bar."""
WAKE_S = 0.2
"""Time until every signal is fresh."""
TENSIONING_SPARE_S = 20.0

Advance = Callable[[float, str], None]
"""Called with the seconds of the run done since the last call (0 in preparation), and the activity in words."""


@dataclass(frozen=True)
class Ended:
    """How a run ended."""

    mode: str  # the loop's; LOCKED without a loop
    fault: str  # latched; NONE without one
    tripped: bool
    tripped_at_s: float | None


@dataclass(frozen=True)
class Played:
    """Results of a run. Times are from the disturbances' start."""

    controller: Literal["loop", "locked"]
    target_n: float
    truth: npt.NDArray[Any]
    """One row per millisecond (locked) or tick (loop), time 0 included, dtype ``TRUTH_DTYPE``."""
    t_s: npt.NDArray[np.float64]
    """Time of each row of ``truth``."""
    records: npt.NDArray[Any] | None
    """The loop's records, one per tick; None when locked."""
    records_t_s: npt.NDArray[np.float64] | None
    """Time of each record."""
    ended: Ended


def play(
    settings: RigSettings,
    tracks: Mapping[int, Track],
    *,
    seconds: float,
    controller: Literal["loop", "locked"],
    target_n: float,
    settle_s: float = 2.0,
    gains: Gains | None = None,
    law: LawFactory | None = None,
    correction: Correction | None = None,
    marks: Sequence[tuple[float, int]] = (),
    progress: Advance | None = None,
    believed: RigSettings | None = None,
) -> Played:
    """Play tracks against a rig.

    Args:
        settings: with a ``simulation`` section.
        tracks: by channel of ``hil.plant.layout``, time 0 is their start.
        seconds: length of the run.
        controller: ``loop``: the real loop, armed, tensioned and settled before; ``locked``: the cylinder holds the
            stroke at which the rig at rest has ``target_n``, brake closed.
        target_n: vertical tension to hold.
        settle_s: time in COMPENSATING before time 0; ``loop`` only.
        gains: of the law; None designs them and refuses what ``rigctl run`` would refuse.
        law: makes another law than the standard one, see `rigctl.control.loop.Loop`.
        correction: of the tension cell, from its ledger; None: the cell as it reads.
        marks: times and numbers of the moves that an operator marks (`rigctl move`); ``loop`` only.
        progress: called with the progress.
        believed: settings of the loop; None are those of the rig, with what their gain file replaces.

    Raises:
        ScenarioError: the rig cannot be simulated or its design is refused (2), or it does not get as far as
            COMPENSATING (1). A trip during the run is a result, not an error.
        RoomError: the memory of the loop's rings is not free.
    """
    advance = progress or _nothing
    if controller == "locked":
        return _play_locked(settings, tracks, seconds, target_n, advance)
    advance(0.0, "designing the law")
    believed = believed or adopted_by(settings)
    designed = gains or design(believed)
    with contextlib.ExitStack() as stack:
        advance(0.0, PREPARING)
        try:
            rig = stack.enter_context(lockstep(believed, designed, law=law, built=settings, correction=correction))
        except RoomError:
            raise
        except (ValueError, OSError) as error:
            raise ScenarioError([f"{settings.rig}: {error}"]) from None
        bring_to_target(rig, target_n, settle_s, advance)
        return _play_loop(rig, tracks, seconds, target_n, advance, marks)


def adopted_by(settings: RigSettings) -> RigSettings:
    """The settings that ``rigctl run`` would run with.

    Raises:
        ScenarioError: the gain file does not fit them.
    """
    try:
        return adopted(settings)
    except DesignError as error:
        raise ScenarioError([f"{settings.rig}: design: {error}"]) from None


def design(settings: RigSettings) -> Gains:
    """The gains ``rigctl run`` would use.

    Raises:
        ScenarioError: the design fails, or ``rigctl run`` would refuse it.
    """
    return accepted_design(settings).gains


def accepted_design(settings: RigSettings) -> Design:
    """The design ``rigctl run`` would use.

    Raises:
        ScenarioError: the design fails, or ``rigctl run`` would refuse it.
    """
    try:
        found = design_in_use(settings)
    except DesignError as error:
        raise ScenarioError([f"{settings.rig}: design: {error}"]) from None
    if found.accepted:
        return found
    if found.waiver is not None:
        raise ScenarioError([f"{settings.rig}: design: unstable with the plant in the file, no waiver helps"])
    raise ScenarioError(
        [
            f"{settings.rig}: design refused: Ms {found.ms_max:.2f} over the family of plants, expected at most "
            f"{found.limit:g}; to run it all the same, say why in change: design: waiver"
        ]
    )


def _play_locked(
    settings: RigSettings, tracks: Mapping[int, Track], seconds: float, target_n: float, advance: Advance
) -> Played:
    advance(0.0, PREPARING)
    try:
        plant = Plant(settings, 0)
    except ValueError as error:
        raise ScenarioError([f"{settings.rig}: {error}"]) from None
    plant.preload(target_n)
    plant.start_motion(tracks, 0)
    count = round(seconds * 1e9 / LOCKED_PERIOD_NS)
    truth = np.empty(count + 1, TRUTH_DTYPE)
    truth[0] = plant.truth
    for first, after in _chunks(count, LOCKED_PERIOD_NS):
        for i in range(first + 1, after + 1):
            plant.advance(i * LOCKED_PERIOD_NS)
            truth[i] = plant.truth
        advance((after - first) * LOCKED_PERIOD_NS * 1e-9, "running")
    ended = Ended("LOCKED", Fault.NONE.name, tripped=False, tripped_at_s=None)
    return Played("locked", target_n, truth, truth["t_ns"] * 1e-9, None, None, ended)


def bring_to_target(rig: Lockstep, target_n: float, settle_s: float, advance: Advance | None = None) -> None:
    """Arm, set the target, tension, settle.

    Raises:
        ScenarioError: the rig is not COMPENSATING then.
    """
    advance = advance or _nothing
    tension, simulation = rig.settings.tension, rig.settings.simulation
    assert simulation is not None  # the rig is simulated
    advance(0.0, "tensioning")
    rig.run(WAKE_S)
    k_n_mm = rig.settings.plant.stiffness_n_mm
    take_up_mm_s = min(tension.speed_max_mm_s, tension.ramp_n_s / k_n_mm)  # slack is taken up at the speed of the ramp
    way_mm = simulation.rope.slack_mm + target_n / k_n_mm
    limit_s = TENSIONING_SPARE_S + target_n / tension.ramp_n_s + way_mm / take_up_mm_s
    waited_s = 0.0

    def tensioned(wanted: Mode, limit_s: float) -> None:
        nonlocal waited_s
        while rig.loop.machine.mode is Mode.TENSIONING and waited_s < limit_s:
            rig.run(WAKE_S)
            waited_s += WAKE_S
        advance(0.0, "settling")
        check(wanted)

    def check(wanted: Mode) -> None:
        mode, fault = rig.loop.machine.mode, rig.loop.machine.fault
        if mode is not wanted:
            words = f"{mode.name}, fault {fault.name}, after {waited_s:.1f} s of tensioning"
            raise TimeoutError(f"not {wanted.name} before the run's start but {words}")

    given_n = None if target_n == tension.target_n else target_n
    try:
        arm_and_tension(rig, target_n=given_n, limit_s=limit_s, until=tensioned, settle_s=settle_s)
        check(Mode.COMPENSATING)
    except (CommandRefusedError, TimeoutError) as error:
        raise ScenarioError([f"{rig.settings.rig}: {error}"], exit_code=1) from None


def _play_loop(
    rig: Lockstep, tracks: Mapping[int, Track], seconds: float, target_n: float, advance: Advance,
    marks: Sequence[tuple[float, int]],
) -> Played:  # fmt: skip
    plant, period_ns = rig.rig.plant, rig.settings.loop.period_ns
    origin_ns = plant.t_ns
    rig.read_records()
    plant.start_motion(tracks, origin_ns)
    count = round(seconds * 1e9 / period_ns)
    truth = np.empty(count + 1, TRUTH_DTYPE)
    truth[0] = plant.truth
    parts = []
    numbers = {round(at_s * 1e9 / period_ns): number for at_s, number in marks}
    for first, after in _chunks(count, period_ns):
        for i in range(first + 1, after + 1):
            if i - 1 in numbers:
                rig.give(Verb.MOVE, numbers[i - 1])
            rig.tick()
            truth[i] = plant.truth
        parts.append(rig.read_records())
        advance((after - first) * period_ns * 1e-9, "running")
    records = np.concatenate(parts)
    t_s, records_t_s = (truth["t_ns"] - origin_ns) * 1e-9, (records["t_ns"] - origin_ns) * 1e-9
    return Played("loop", target_n, truth, t_s, records, records_t_s, _ending(records, records_t_s))


def _ending(records: npt.NDArray[Any], t_s: npt.NDArray[np.float64]) -> Ended:
    tripped = np.flatnonzero(records["mode"] == Mode.FAULT)
    at_s = float(t_s[tripped[0]]) if len(tripped) else None
    last = records[-1]
    return Ended(Mode(last["mode"]).name, Fault(last["fault"]).name, tripped=at_s is not None, tripped_at_s=at_s)


def _chunks(count: int, period_ns: int) -> Iterator[tuple[int, int]]:
    """Spans of steps, ``CHUNK_S`` each."""
    size = max(1, round(CHUNK_S * 1e9 / period_ns))
    for first in range(0, count, size):
        yield first, min(first + size, count)


def _nothing(_seconds: float, _doing: str) -> None:
    """The default progress callback: does nothing."""
