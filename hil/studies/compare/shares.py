"""The study of `python -m hil compare --shares`: what each law makes of each group of runs, over three seeds.

Tuning, identification and measurement of Ms are those of `equal_limits`, and so are the rows, so that a file of rows
serves both. A law is tuned once for a run's rig, and its Ms measured, with the file's seed; the run is repeated with
each seed of the simulated rig. Groups, seeds and ties are those of `groups`.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.runs.rows_file import RowsFile
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import WAIVER
from hil.studies.compare.equal_limits import (
    Known,
    RunErrors,
    identified_by,
    loop_law,
    peak_by,
    played,
    spread_in_words,
    tuning,
)
from hil.studies.compare.groups import GROUPS, LOWEST, TIED, GroupError, group_error, places, seeds
from hil.studies.compare.measured_ms import Peak
from hil.studies.compare.rivals import OURS
from hil.studies.compare.tuned_laws import LAW_VERSION
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings

JOINT = "joint"
Say = Callable[[str], None]


class PlayedLaw(NamedTuple):
    """A law in a run with each seed."""

    rms_pct: tuple[float | None, ...]
    """None where the run did not reach its end."""
    max_pct: tuple[float | None, ...]
    ended: tuple[str, ...]
    peak: Peak | None
    """Ms measured with the first seed; its interval holds what noise makes of it.

    None where the rig does not stay in COMPENSATING meanwhile.
    """
    within: bool
    """Whether the tuning keeps the limits of Ms and noise."""


class Shares(NamedTuple):
    """The study."""

    rig: RigSettings
    groups: dict[str, tuple[str, ...]]
    """Names of the runs."""
    laws: tuple[str, ...]
    played: dict[tuple[str, str], PlayedLaw]
    """By run and law."""
    bounds_pct: dict[str, float | None]
    """By run; None where there is no bound."""

    def errors(self, group: str) -> dict[str, GroupError | None]:
        """By law."""
        return {
            law: group_error(list(zip(*(self.played[run, law].rms_pct for run in self.groups[group]), strict=True)))
            for law in self.laws
        }

    def over_bound(self, group: str, law: str) -> float | None:
        """Error over bound, the geometric mean of the runs that have one; None without."""
        bounds = [(run, bound) for run in self.groups[group] if (bound := self.bounds_pct.get(run)) is not None]
        shares = []
        for run, bound in bounds:
            found = group_error([(value,) for value in self.played[run, law].rms_pct])
            if found is None:
                return None
            shares.append(found.error_pct / bound)
        return statistics.geometric_mean(shares) if shares else None

    def peak(self, group: str, law: str) -> Peak | None:
        """The largest Ms measured in the group; None where one was not measured."""
        found = [self.played[run, law].peak for run in self.groups[group]]
        known = [peak for peak in found if peak is not None]
        return max(known, key=lambda peak: peak.ms) if len(known) == len(found) else None

    def counts(self) -> dict[str, int]:
        """Groups in which a law is lowest or tied."""
        found = {group: places(self.errors(group)) for group in self.groups}
        return {law: sum(found[group][law] in (LOWEST, TIED) for group in self.groups) for law in self.laws}

    def ended_early(self) -> list[str]:
        """Runs that our law did not reach the end of."""
        return [run for (run, law), row in self.played.items() if law == OURS and None in row.rms_pct]

    def least_by_case(self, runs: Mapping[str, str]) -> dict[str, float] | None:
        """The least error of all laws, N rms, by the keys of ``runs``; None where one of these runs was not played."""
        found = {}
        for case, run in runs.items():
            rows = [self.played[run, law].rms_pct for law in self.laws if (run, law) in self.played]
            errors = [
                error.error_pct for row in rows if (error := group_error([(value,) for value in row])) is not None
            ]
            if not errors:
                return None
            found[case] = 0.01 * self.rig.tension.target_n * min(errors)
        return found


def study(
    rig: RigSettings, runs: Sequence[ComparedRun], groups: Sequence[str], laws: Sequence[str], rows: RowsFile, say: Say,
    bound_pct: Callable[[ComparedRun], float | None], designs: int | None = None,
) -> Shares:  # fmt: skip
    """Tune and play every law in every run of the groups; what ``rows`` has already is not done again.

    ``bound_pct``: of a run. ``designs``: tried for each knob and start; None: as `tuned_laws.EVALUATIONS`.

    Raises:
        ScenarioError: the rig cannot be simulated.
    """
    chosen = {group: GROUPS[group] for group in groups}
    names = [name for group in chosen.values() for name in group]
    by_name = {run.name: run for run in runs}
    bounds = {name: bound_pct(by_name[name]) for name in names}
    found = dict[tuple[str, str], PlayedLaw]()
    for law in laws if names else ():
        base = tuning(Known.of(rig), law, rows, designs=designs)
        say(f"{law}: tuned for the rig of the file, Ms {base.ms:.2f}, starts {spread_in_words(base)}")
        for name in names:
            settings = by_name[name].settings(rig, WAIVER)
            known = Known.of(settings, identified_by(settings, name, rows))
            mine = tuning(known, law, rows, base, designs=designs)
            runs_by = loop_law(known, mine)
            peak, outcomes = peak_by(settings, known, law, runs_by, rows), []
            for number, seed in enumerate(seeds(rig)):
                there = changed(settings, {"simulation.seed": seed})
                again = f" seed {seed}" if number else ""  # that of the file has the keys of `equal_limits`
                key = f"play {name} {law}{again}"
                kept = rows.get(key) or rows.put(key, played(there, runs_by, by_name[name])._asdict())
                outcomes.append(RunErrors(**kept))
            errors = tuple(outcome.eta_rms_pct for outcome in outcomes)
            largest = tuple(outcome.eta_max_pct for outcome in outcomes)
            found[name, law] = PlayedLaw(
                errors, largest, tuple(outcome.ended for outcome in outcomes), peak, mine.within
            )
            say(f"{law}: {name}: rms {', '.join('none' if e is None else f'{e:.4f}' for e in errors)} %")
    return Shares(rig, chosen, tuple(laws), found, bounds)


def document(found: Shares, joint: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Everything that is printed, for JSON; ``joint``: the joint bounds as dictionaries."""
    design = found.rig.design
    return {
        "limits": {"ms": design.ms_max, "command_noise_mm_s": design.command_noise_max_mm_s},
        "law_version": LAW_VERSION,
        "seeds": list(seeds(found.rig)),
        "groups": {group: _group(found, group) for group in found.groups},
        "lowest_or_tied": found.counts(),
        "joint": list(joint),
    }


def _group(found: Shares, group: str) -> dict[str, Any]:
    errors = found.errors(group)
    place = places(errors)
    runs = found.groups[group]
    return {
        "bounds_pct": {run: found.bounds_pct[run] for run in runs},
        "laws": {
            law: {
                "error_pct": None if (error := errors[law]) is None else error.error_pct,
                "spread": None if error is None else error.spread,
                "place": place[law],
                "over_bound": found.over_bound(group, law),
                "ms_measured": None if (peak := found.peak(group, law)) is None else peak._asdict(),
                "runs": {run: _run(found.played[run, law]) for run in runs},
            }
            for law in found.laws
        },
    }


def _run(row: PlayedLaw) -> dict[str, Any]:
    return {"rms_pct": list(row.rms_pct), "max_pct": list(row.max_pct), "ended": list(row.ended), "within": row.within}
