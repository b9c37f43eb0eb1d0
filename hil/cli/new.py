"""``python -m hil new rig NAME``: a rig file with its EDS files, from options or questions."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Mapping

from hil.new import rig_folder
from hil.new.new_rig import check_name, make, paper
from hil.new.rig_decisions import DECISIONS, DecidedRig, RigDecision, default
from hil.scenario.errors import ScenarioError
from rigctl.config.settings import RigSettings
from rigctl.config.typed_number import TypedNumber, TypedNumberError
from rigctl.model.quantity import significant


def run(
    name: str,
    given: Mapping[RigDecision, float | None],
    out: pathlib.Path | None,
    *,
    bus: Mapping[str, int | None] | None = None,
    defaults: bool,
) -> int:
    """Make the rig, write it, say what was written; returns 0.

    Args:
        name: the rig's.
        given: the options; None where there is none.
        out: folder; None = one of the rig's name.
        bus: rate of the loop, bit rate and node ids by their keys; None where there is no option.
        defaults: ask nothing.

    Raises:
        ScenarioError: there is no such rig, or something would have to be overwritten.
        ConfigError: the paper's rig is not installed.
        OSError: a file cannot be written.
        KeyboardInterrupt: the questions were not answered to their end.
    """
    folder = out if out is not None else pathlib.Path(name)
    check_name(name)
    for decision, value in given.items():
        if value is not None:
            decision.check(value)
    _, settings = paper()
    files = rig_folder.beside(settings)
    rig_folder.check(folder, name, files)  # before the questions
    chosen = {key: value for key, value in (bus or {}).items() if value is not None}
    ask = not defaults and sys.stdin.isatty()
    found = make(name, DecidedRig.of(_decisions(given, settings, ask=ask)), chosen)
    file = rig_folder.write(folder, name, found.text, files)
    tension, stiffness = found.settings.tension, found.settings.plant.stiffness_n_mm
    lines = [f"{file}: rig {name}, {tension.target_n:g} N on {stiffness:.4g} N/mm; with eds/ and schema/ beside it"]
    lines += [f"design: Ms {found.ms_max:.2f} (limit {found.settings.design.ms_max:g})"]
    if found.weights:
        lines[-1] += f" with {', '.join(found.weights)}; the limits in section demo are the paper's"
    lines += [f"next: rigctl check {file}", f"      rigctl demo {file} --lockstep"]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def _decisions(
    given: Mapping[RigDecision, float | None], settings: RigSettings, *, ask: bool
) -> dict[RigDecision, float]:
    found: dict[RigDecision, float] = {}
    for decision in DECISIONS:
        value = given.get(decision)
        if value is None:
            usual = default(decision, found, settings)
            value = _asked(decision, usual) if ask else usual
        found[decision] = value
    return found


def _asked(decision: RigDecision, usual: float) -> float:
    """The answer on the terminal; an empty one is the usual value."""
    while True:
        sys.stderr.write(f"{decision.meaning} ({decision.allowed}) [{significant(usual)}]: ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:  # end of the input: Ctrl-D
            sys.stderr.write("\n")
            raise KeyboardInterrupt
        answer = line.strip()
        try:
            value = TypedNumber(decision.unit).read(answer) if answer else usual
            decision.check(value)
        except ScenarioError as error:
            sys.stderr.write(f"{error}\n")
        except TypedNumberError as error:
            sys.stderr.write(f"{decision.option}: {error}\n")
        else:
            return value
