"""``rigctl watch``: follow the rig until Ctrl-C, through restarts of the gateway and of the daemon."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import TYPE_CHECKING

from rigctl.cli.options import DONE, USAGE, Connect, Json, Rig, end, say, say_json
from rigctl.ipc import standard_output
from rigctl.wire import state_words as figures

if TYPE_CHECKING:
    from rigctl.client.connection import Client, NoDaemonError
    from rigctl.client.rig_view import RigFollower, RigView

REFRESH_S = 0.1
RETRY_S = 0.5
"""Interval between searches for a daemon that does not run yet."""


def watch(json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Follow the rig; Ctrl-C ends. Waits for a daemon. One line per second where the output is no terminal."""
    with contextlib.suppress(KeyboardInterrupt), _daemon(connect, rig) as client:
        from rigctl.client.rig_view import RigFollower, RigView

        follower = RigFollower(client, RigView(client.endpoint, client.rig))
        if json:
            _print_states(follower)
        elif sys.stdout.isatty():
            _show_screen(follower)
        else:
            _print_lines(follower)
    end(DONE)


def _daemon(connect: str | None, rig: str | None) -> Client:
    """A client of the daemon, as soon as it runs; a wrong endpoint or rig ends the command with one line."""
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError, endpoint_of

    waiting = ""
    while True:
        if standard_output.nobody_reads():
            end(DONE)
        try:
            return Client(connect, rig)
        except ChoiceError as error:
            end(USAGE, str(error))
        except NoDaemonError as error:
            # Printed to standard error, as standard output may be JSON for a program.
            if not waiting:
                of = f" of {wanted}" if (wanted := rig or os.environ.get("RIGCTL_RIG")) else ""
                sys.stderr.write(f"waiting for a daemon{of} at {endpoint_of(connect)}; Ctrl-C ends\n")
            if (why := _why(endpoint_of(connect), rig, error)) != waiting:
                sys.stderr.write(f"{why}\n")
                sys.stderr.flush()
            waiting = why
            time.sleep(RETRY_S)


def _why(endpoint: str, rig: str | None, error: NoDaemonError) -> str:
    """Why no daemon answers, without figures, so that it changes with the cause alone."""
    from rigctl.cli.unanswered import cause_of
    from rigctl.client.connection import OtherRigError

    if isinstance(error, OtherRigError):
        return str(error)
    found = cause_of(endpoint, rig, error)
    return f"{found.cause.value}: {found.wrong}; load: {found.does}"


def _print_states(follower: RigFollower) -> None:
    while not standard_output.nobody_reads():
        for state in follower.update():
            say_json(state)
        time.sleep(REFRESH_S / 5)


def line(view: RigView) -> str:
    """The view in one line."""
    if view.is_silent or view.state is None:
        from rigctl.cli.unanswered import line as unanswered_line
        from rigctl.client.unanswered import unanswered_here

        found = unanswered_here(view.endpoint, view.rig)
        why = f"  {unanswered_line(found)}" if found is not None else ""
        return f"no data for {view.silent_s:.0f} s from {view.endpoint}{why}"
    state = view.state
    if state.get("mode") is None:
        return f"{figures.mode(state)}  {figures.why(state)}"
    late = state["lateness_us"] or {"p99": 0, "max": 0}
    parts = [
        figures.clock(state["wall_ns"])[:-2],
        f"{figures.mode(state):<12}",
        figures.held(state),
        f"{figures.measured(state, 'vertical_n'):>9}",
        f"error {figures.error(state).split(' (not')[0]}",
        f"stroke {figures.measured(state, 'stroke_mm')}",
        f"tilt {figures.measured(state, 'tangential_deg')}",
        f"late p99 {late['p99']:.0f} max {late['max']:.0f} us",
        f"lease {state['lease']['holder']}" if state.get("lease") else "",
        figures.why(state),
        view.refused,
    ]
    return "  ".join(part for part in parts if part.strip())


def _print_lines(follower: RigFollower) -> None:
    due = time.monotonic() + 0.2
    while not standard_output.nobody_reads():
        follower.update()
        if time.monotonic() >= due and (follower.view.state is not None or follower.view.is_silent):
            due += 1.0
            say(line(follower.view))
        time.sleep(REFRESH_S)


def _show_screen(follower: RigFollower) -> None:
    from rich.console import Console
    from rich.live import Live

    from rigctl.cli.watch_screen import Screen

    console = Console(highlight=False)
    screen = Screen(follower.view)
    with Live(screen, console=console, screen=True, auto_refresh=False) as live:
        while True:
            follower.update()
            live.refresh()
            time.sleep(REFRESH_S)
