"""What `rigctl status` and `rigctl watch` print where no daemon answers, see `rigctl.client.unanswered`."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from rigctl.cli.label_grid import grid
from rigctl.cli.options import BAD, USAGE, end, say_json
from rigctl.client.unanswered import Obstacle, Unanswered, unanswered
from rigctl.wire import state_words as figures

_NEVER = {"mode": None, "loop_alive": False}


def cause_of(endpoint: str, rig: str | None, error: Exception) -> Unanswered:
    """Why the daemon does not answer; ``rig``: as given, else ``RIGCTL_RIG``."""
    return unanswered(endpoint, rig or os.environ.get("RIGCTL_RIG") or None, error)


def rows(found: Unanswered) -> list[tuple[str, str, str]]:
    """Label, value and style, line by line: the cause, what this computer shows of the rig, what to do next."""
    result = [(found.cause.value, found.wrong, "bold red")]
    state = found.state
    if state is not None and state["mode"] is not None:
        alive = state["loop_alive"]
        tension = figures.measured(state, "tension_n") if alive else "not known"
        shown = f" {state['mode']}   {state['age_ms'] / 1000:.1f} s {'old' if alive else 'ago'}, tension {tension}"
        result.append(("mode", shown, figures.mode_style(state) if alive else ""))
        result += [("fault", str(state["fault"]), "bold red")] if state["fault"] else []
    elif state is not None:
        result.append(("mode", f" {figures.mode(state)} ", figures.mode_style(state)))
    return [*result, ("load", found.does, ""), ("next step", found.next_step, "bold")]


def line(found: Unanswered) -> str:
    """The same in one line."""
    return "  ".join(f"{label}: {' '.join(value.split())}" for label, value, _ in rows(found)[:-1])


def end_unanswered(endpoint: str, rig: str | None, error: Exception, *, json: bool) -> NoReturn:
    """Print what there is in place of a state, and end: 2 and one line for an unknown host or a missing key, else 1."""
    from rigctl.client.connection import NoKeyError

    found = cause_of(endpoint, rig, error)
    if found.cause is Obstacle.HOST:
        end(USAGE, f"{found.wrong}; what the rig does is {found.does}.  {found.next_step}")
    no_key = isinstance(error, NoKeyError)
    if no_key and found.state is None:
        end(USAGE, str(error))
    if json:
        words = {"cause": found.cause.name, "wrong": found.wrong, "does": found.does, "steps": found.steps}
        say_json({"rig": found.rig or None, "unanswered": words, **(found.state or _NEVER)})
    else:
        _print(found, endpoint, rig)
    end(USAGE if no_key else BAD, str(error) if no_key else None)


def _print(found: Unanswered, endpoint: str, rig: str | None) -> None:
    from rich.console import Console
    from rich.text import Text

    table = grid([("rig", Text(f"{found.rig or rig or 'no rig'} at {endpoint}"))])
    for label, value, style in rows(found):
        table.add_row(label, Text(value, style))
    Console(highlight=False, file=sys.stdout).print(table)
