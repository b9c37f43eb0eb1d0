"""Plays rows of the catalogue to their ends, and from one of each distinct end the displayed steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.branching import BranchError
from hil.faults import in_plant
from hil.faults.catalogue import ROWS
from hil.faults.expected import InjectedFault
from hil.faults.judging.standing import restoring
from hil.faults.lockstep_run import Bench, by_start, to_tensioning
from hil.faults.stand import NoDeviceError, Stand
from hil.runs import runner
from hil.runs.rows_file import RowsFile
from hil.runs.runner import Work
from hil.scenario.play import Advance, design
from hil.ways_out.step_follower import End, StepFollower
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.parts import Part
from rigctl.model.states import Mode

SETTLES_S = 4.0
"""After its seconds: a load that is held comes on the brake, and is seen at rest."""
Row = tuple[InjectedFault, Mode]
_bench: list[Bench] = []
"""The bench of this process."""


class LedOut(NamedTuple):
    """A distinct end, the rows that end so, and whether the steps displayed at the first of them lead out."""

    end: End
    rows: tuple[str, ...]
    leads: bool
    why: str
    taken: tuple[str, ...]
    misoffered: tuple[str, ...]


def play(rig: RigSettings, rows: Sequence[Row], kept: RowsFile, advance: Advance) -> list[LedOut]:
    """Play what ``kept`` has not got yet; returns the distinct ends, those without a way out first.

    Raises:
        ScenarioError: the design of the rig's law is refused.
    """
    start = (rig, design(rig))
    _work("end", rows, kept, advance, start)
    found: dict[End, list[Row]] = {}
    for fault, mode in sorted(rows, key=lambda row: (row[0].id, row[1])):
        end = kept.get(_key("end", fault, mode))
        if end is not None and not isinstance(end, str):
            found.setdefault(_end(end), []).append((fault, mode))
    firsts = [first for first, *_ in found.values()]
    _work("way out", firsts, kept, advance, start)
    led = (_led_out(end, ending, kept.get(_key("way out", *ending[0]))) for end, ending in found.items())
    return sorted(led, key=lambda one: (one.leads, one.end))


def unplayed(rows: Sequence[Row], kept: RowsFile) -> Mapping[str, str]:
    """Rows that have no end, with why."""
    found = {f"{fault.id} in {mode.name}": kept.get(_key("end", fault, mode)) for fault, mode in rows}
    return {name: why for name, why in found.items() if isinstance(why, str)}


def _led_out(end: End, rows: Iterable[Row], found: Any) -> LedOut:
    names = tuple(f"{fault.id} in {mode.name}" for fault, mode in rows)
    if isinstance(found, str):
        return LedOut(end, names, False, found, (), ())
    leads, why, taken, misoffered = found
    return LedOut(end, names, bool(leads), str(why), tuple(taken), tuple(misoffered))


def _key(what: str, fault: InjectedFault, mode: Mode) -> str:
    return f"{what} {fault.id} {mode.name}"


def _end(found: Sequence[Any]) -> End:
    return End._make([*found[:-1], tuple(found[-1])])


def _work(what: str, rows: Sequence[Row], kept: RowsFile, advance: Advance, start: tuple[RigSettings, Gains]) -> None:
    missing = by_start((fault, mode) for fault, mode in rows if kept.get(_key(what, fault, mode)) is None)
    if len(missing) < len(rows):
        advance(len(rows) - len(missing), "")
    pieces = {
        _key(what, fault, mode): Work(_play, (what, fault.id, mode), f"{what} {fault.id} in {mode.name}")
        for fault, mode in missing
    }
    if pieces:
        runner.play(pieces, advance, keep=kept.put, pieces_per_worker=4, start=_start, start_arguments=start)


def _start(rig: RigSettings, gains: Gains) -> None:
    _bench[:] = [Bench(rig, gains)]


def _play(what: str, fault_id: str, mode: Mode) -> Any:
    """The end of a row, or the way out of it; why it cannot be played where that is so."""
    fault = ROWS[fault_id]
    try:
        return _bench[0].branch(fault, mode, lambda stand: _to_end(fault, stand, leads=what == "way out"))
    except (RuntimeError, TimeoutError, BranchError, NoDeviceError) as error:
        return f"{type(error).__name__}: {error}"


def _to_end(fault: InjectedFault, stand: Stand, *, leads: bool) -> Any:
    rig = stand.lockstep
    undo = restoring(rig)
    if fault.around.motion is not None:
        stand.plant.start_motion(fault.around.motion(), stand.plant.t_ns)
    step = fault.inject(stand)
    if fault.from_start:
        to_tensioning(rig)

    def mend() -> None:
        for action in undo:
            action()
        if Part.PAYLOAD in fault.part:
            in_plant.let_go_of(stand.plant)

    operator = StepFollower(rig, fault.part, mend, step)
    operator.run(fault.seconds + fault.after_s + SETTLES_S)
    return operator.go() if leads else End.of(operator.state(), rig.view.action)
