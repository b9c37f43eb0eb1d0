"""``rigctl watch``: follow the rig until Ctrl-C, through restarts of the gateway and of the daemon."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rigctl.cli import standard_output
from rigctl.cli.options import DONE, USAGE, Connect, Json, Rig, end, say, say_json
from rigctl.wire import state_words as figures
from rigctl.wire.passed_limits import PassedLimits

if TYPE_CHECKING:
    from rigctl.client.connection import Client

REFRESH_S = 0.1
RETRY_S = 0.5
"""Interval between searches for a daemon that does not run yet."""
SILENT_S = 1.0
_EVENTS_HELD = 100


@dataclass
class View:
    """The data that the screen shows."""

    rig: str
    endpoint: str
    state: dict[str, Any] | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    limits: PassedLimits = field(default_factory=PassedLimits)
    refused: str = ""  # number of messages without the shape of a daemon's, in words
    heard: float = field(default_factory=time.monotonic)

    @property
    def silent_s(self) -> float:
        """Seconds without data, 0 while data arrive."""
        silence = time.monotonic() - self.heard
        return silence if silence > SILENT_S else 0.0


class Follower:
    """Keeps a view up to date; after a restart of the gateway it queries the missed events."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._states = client.follow(client.keys.state)
        self._events = client.follow(client.keys.event("*"), _EVENTS_HELD)
        self._gateway = 0
        self.view = View(client.rig, client.endpoint)

    def update(self) -> list[dict[str, Any]]:
        """Take all data that arrived; returns the states, oldest first."""
        states = []
        while (state := self._states.take()) is not None:
            states.append(state)
        if states:
            self.view.state, self.view.heard = states[-1], time.monotonic()
            if states[-1].get("gateway_wall_ns", 0) != self._gateway:
                self._catch_up(states[-1].get("gateway_wall_ns", 0))
        while (event := self._events.take()) is not None:
            if all(event["t_ns"] != known["t_ns"] or event["seq"] != known["seq"] for known in self.view.events):
                self.view.events.append(event)
                self.view.limits.note(event)
        del self.view.events[:-_EVENTS_HELD]
        self.view.refused = self._client.refusals.words
        return states

    def _catch_up(self, gateway: int) -> None:
        from rigctl.client.connection import NoDaemonError

        with contextlib.suppress(NoDaemonError):
            self.view.settings = self._client.active().get("settings") or {}
            past = self._client.past_events()
            self.view.events = past[-_EVENTS_HELD:]
            self.view.limits.clear()
            for event in past:
                self.view.limits.note(event)
            self._gateway = gateway


def watch(json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Follow the rig; Ctrl-C ends. Waits for a daemon. One line per second where the output is no terminal."""
    with contextlib.suppress(KeyboardInterrupt), _daemon(connect, rig) as client:
        follower = Follower(client)
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

    waiting = False
    while True:
        if standard_output.nobody_reads():
            end(DONE)
        try:
            return Client(connect, rig)
        except ChoiceError as error:
            end(USAGE, str(error))
        except NoDaemonError:
            if not waiting:  # printed to standard error, as standard output may be JSON for a program
                of = f" of {wanted}" if (wanted := rig or os.environ.get("RIGCTL_RIG")) else ""
                sys.stderr.write(f"waiting for a daemon{of} at {endpoint_of(connect)}; Ctrl-C ends\n")
                sys.stderr.flush()
            waiting = True
            time.sleep(RETRY_S)


def _print_states(follower: Follower) -> None:
    while not standard_output.nobody_reads():
        for state in follower.update():
            say_json(state)
        time.sleep(REFRESH_S / 5)


def line(view: View) -> str:
    """The view in one line."""
    if view.silent_s or view.state is None:
        return f"no data for {time.monotonic() - view.heard:.0f} s from {view.endpoint}"
    state = view.state
    if state.get("mode") is None:
        return f"{figures.mode(state)}  {figures.why(state)}"
    late = state["lateness_us"] or {"p99": 0, "max": 0}
    parts = [
        figures.clock(state["wall_ns"])[:-2],
        f"{figures.mode(state):<12}",
        f"{figures.number(state['vertical_n'], 2, 'N'):>9}",
        f"error {figures.error(state).split(' (not')[0]}",
        f"stroke {figures.number(state['stroke_mm'], 2, 'mm')}",
        f"tilt {figures.number(state['tangential_deg'], 2, 'deg', sign=True)}",
        f"late p99 {late['p99']:.0f} max {late['max']:.0f} us",
        f"lease {state['lease']['holder']}" if state.get("lease") else "",
        figures.why(state),
        view.refused,
    ]
    return "  ".join(part for part in parts if part.strip())


def _print_lines(follower: Follower) -> None:
    due = time.monotonic() + 0.2
    while not standard_output.nobody_reads():
        follower.update()
        if time.monotonic() >= due and (follower.view.state is not None or follower.view.silent_s):
            due += 1.0
            say(line(follower.view))
        time.sleep(REFRESH_S)


def _show_screen(follower: Follower) -> None:
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
