"""Why no daemon answers, what the rig does now as far as this computer shows it, and what to do next.

On the rig's computer the public slot (`rigctl.ipc.public_slot`) shows the loop without the gateway. Where the endpoint
is another computer's, only the network is looked at (`rigctl.client.endpoint_probe`).
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import pathlib
import time
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rigctl.client.connection import ChoiceError, NoDaemonError, NoKeyError, credentials_of
from rigctl.client.endpoint_probe import LIMIT_S, Met, Probed, probe
from rigctl.client.local_daemons import LocalDaemon, local_daemons, meant
from rigctl.config.address import Address, here, is_local
from rigctl.identity.credentials import Credentials
from rigctl.ipc import public_slot, wall_clock
from rigctl.ipc.folder_places import GATEWAY_SOCKET
from rigctl.wire.public_state import public_state
from rigctl.wire.state_words import held, if_it_moves
from rigctl.wire.user_name import user_name

_HALL = "Keep out of the hall."
_AT_RIG = "At the rig's computer: rigctl status."
_ELSEWHERE = "not known from here"


class Obstacle(StrEnum):
    """What keeps a daemon from answering."""

    GATEWAY = "gateway"
    STARTING = "start"
    LOOP = "loop"
    NOT_ALLOWED = "access"
    PORT = "port"
    HOST = "host"


@dataclass(frozen=True)
class Unanswered:
    """The answer in place of the daemon's. ``rig``: empty where it is not known.

    ``state``: what the public slot shows, as `public_state`; None on another computer, and where there is none.
    """

    cause: Obstacle
    wrong: str
    does: str
    steps: tuple[str, ...]
    rig: str = ""
    state: dict[str, Any] | None = None

    @property
    def next_step(self) -> str:
        """The steps in one line, numbered."""
        return "  ".join(f"{at} {step}" for at, step in enumerate(self.steps, 1))


def unanswered(endpoint: str, rig: str | None, error: Exception, key: pathlib.Path | str | None = None) -> Unanswered:
    """Why nothing answers at ``endpoint``; ``error``: the client's; ``key``: its key file, else ``RIGCTL_KEY``."""
    daemon, owned = _here(endpoint, rig), None
    if isinstance(error, NoKeyError):
        return _no_key(daemon, error)
    with contextlib.suppress(ChoiceError):
        owned = credentials_of(endpoint, key)
    if daemon is not None and owned is None:  # the client has taken the socket of this computer
        return _local(daemon)
    found, connected = probe(here(endpoint), owned), isinstance(error, NoDaemonError) and error.connected
    if owned is not None and (why := _not_allowed(endpoint, found, owned, connected=connected)):
        return why if daemon is None else _with_slot(why.cause, why.wrong, why.steps, daemon)
    if daemon is not None:
        return _local(daemon)
    if found.met in (Met.UNKNOWN_HOST, Met.SILENT_HOST):
        return _host(endpoint, found)
    return _port(endpoint, rig, found, connected=connected)


def unanswered_here(endpoint: str, rig: str | None) -> Unanswered | None:
    """Why the daemon of this computer that is meant does not answer, without the network; None where none is meant."""
    return None if (daemon := _here(endpoint, rig)) is None else _local(daemon)


def _no_key(daemon: LocalDaemon | None, error: NoKeyError) -> Unanswered:
    if daemon is None:
        return Unanswered(Obstacle.NOT_ALLOWED, str(error), _ELSEWHERE, ("Give a key file.", _AT_RIG))
    wrong = f"{user_name(os.geteuid())} may not open {daemon.place.place(GATEWAY_SOCKET)}, and has no key file"
    mend = "root: rigctl install FILE --viewer USER, or a key file in RIGCTL_KEY."
    return _with_slot(Obstacle.NOT_ALLOWED, wrong, (mend, "rigctl hold needs neither."), daemon)


def _local(daemon: LocalDaemon) -> Unanswered:
    """Why a daemon of this computer does not answer, by its public slot."""
    state = _state(daemon)
    steps: tuple[str, ...]
    if not daemon.runs:
        steps = _HALL, if_it_moves(state or {}), "rigctl doctor, then start the daemon anew."
        return _with_slot(Obstacle.LOOP, "the supervisor has been killed, and a loop without it ends", steps, daemon)
    waits_for = None if state is None else state["waits_for"]
    if state is None or (state["mode"] is not None and (state["loop_alive"] or not state["written"]) and not waits_for):
        return _gateway(daemon, state)
    if waits_for and (state["mode"] is None or state["loop_alive"]):
        steps = _HALL, "Wait: rigctl status again. If it does not come: see the daemon's log."
        return _with_slot(Obstacle.STARTING, f"the daemon starts, and waits for: {waits_for}", steps, daemon)
    why = f"no records; its next start waits for: {waits_for}" if waits_for else "no records: it has ended, or hangs"
    steps = _HALL, if_it_moves(state), "rigctl status again: the loop comes back DISARMED."
    return _with_slot(Obstacle.LOOP, why, steps, daemon)


def _here(endpoint: str, rig: str | None) -> LocalDaemon | None:
    """The daemon of this computer that is meant, as for `rigctl.client.local_hold`, else the rest of a killed one."""
    own = meant(local_daemons(), endpoint, rig)
    others = meant(local_daemons(of_others=True), endpoint, rig)
    running = [one for one in (*own, *others) if one.runs]
    left = [one for one in own if public_slot.read(one.place) is not None]
    return next(iter((*running, *left)), None)


def _state(daemon: LocalDaemon) -> dict[str, Any] | None:
    slot = public_slot.read(daemon.place)
    return None if slot is None else public_state(slot, time.monotonic_ns())


def _gateway(daemon: LocalDaemon, state: dict[str, Any] | None) -> Unanswered:
    pid = 0
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        pid = int(json.loads(daemon.place.sealed("gateway.pid.json"))["pid"])
    lives = pid > 0 and pathlib.Path(f"/proc/{pid}").exists()
    if state is not None and not state["written"]:
        since_s = state["looked_ms"] / 1000
        wrong = f"gateway and supervisor hang, or this computer is stalled: nothing new for {since_s:.0f} s"
        steps = _HALL, "rigctl hold still reaches a loop that runs.", "rigctl doctor, and the daemon's log."
        return _with_slot(Obstacle.GATEWAY, wrong, steps, daemon)
    what = f"it hangs, or is just starting (process {pid})" if lives else "it has ended"
    wrong = f"{what}: nothing is published, no command but HOLD is taken"
    again = "rigctl status again: a gateway that has ended or hangs is started anew within 10 s."
    return _with_slot(Obstacle.GATEWAY, wrong, (_HALL, "rigctl hold works, past the gateway.", again), daemon)


def _with_slot(cause: Obstacle, wrong: str, steps: tuple[str, ...], daemon: LocalDaemon) -> Unanswered:
    """The answer with what the public slot of this computer's daemon shows."""
    state, trusted = _state(daemon), daemon.place.is_shared or daemon.owner == os.geteuid()
    wrong = wrong if trusted else f"{wrong} (the daemon is of {user_name(daemon.owner)})"
    return Unanswered(cause, wrong, _does(state), steps, daemon.rig, state)


def _does(state: dict[str, Any] | None) -> str:
    if state is None:
        return "not known: the daemon shows no public slot"
    if state["mode"] is None:
        return "no loop has run yet: this start has not enabled the drive"
    if state["loop_alive"]:
        return f"the loop runs on: {held(state)}"
    return "not known: a drive that hears no loop stops and brakes by itself"


def _not_allowed(endpoint: str, found: Probed, owned: Credentials, *, connected: bool) -> Unanswered | None:
    """The answer where the daemon refuses the key; None where it does not."""
    if found.met is Met.REFUSES_KEY:
        wrong = f"{endpoint} refuses the key of {owned.name} ({found.words})"
    elif found.met is Met.OTHER_AUTHORITY:
        wrong = f"the key of {owned.name} is not of the rig at {endpoint} ({found.words})"
    elif found.met is Met.OPEN and connected:
        wrong = f"{endpoint} takes the key of {owned.name}, and shows it no rig: it is revoked, or of another rig"
    else:
        return None
    clock = wall_clock.unset(datetime.datetime.now(datetime.UTC))
    mend = f"Set this computer's clock: {clock}." if clock else "At the rig's computer: rigctl keys list, renew or add."
    return Unanswered(Obstacle.NOT_ALLOWED, wrong, _ELSEWHERE, (mend, "HOLD at the rig's computer: rigctl hold."))


def _host(endpoint: str, found: Probed) -> Unanswered:
    host = Address.parse(endpoint.partition("/")[2]).host
    silent = f"does not answer within {LIMIT_S:.0f} s"
    what = "is not known to this computer" if found.met is Met.UNKNOWN_HOST else silent
    steps = "Correct it: --connect PROTOCOL/HOST:PORT, or RIGCTL_CONNECT.", _AT_RIG
    return Unanswered(Obstacle.HOST, f"host {host} {what} ({found.words})", _ELSEWHERE, steps)


def _port(endpoint: str, rig: str | None, found: Probed, *, connected: bool) -> Unanswered:
    """Nothing, or no daemon, listens at the port; on this computer its daemons listen elsewhere, or there is none."""
    if found.met is Met.NOTHING:
        wrong = f"nothing listens at {endpoint}"
    elif connected:
        wrong = f"a Zenoh router without a rig listens at {endpoint}"
    elif found.met is Met.NO_ADDRESS:
        wrong = f"no daemon listens at {endpoint}"
    else:
        wrong = f"what listens at {endpoint} is no daemon, or a gateway that hangs"
    if not is_local(endpoint):
        steps = _AT_RIG, "Its port is that of telemetry.listen in the rig file: --connect PROTOCOL/HOST:PORT."
        return Unanswered(Obstacle.PORT, wrong, _ELSEWHERE, steps)
    daemons = [one for one in (*local_daemons(), *local_daemons(of_others=True)) if one.runs]
    daemons = [one for one in daemons if one.rig == rig] or daemons
    if not daemons:
        start = "rigctl run FILE, or of the installed service: systemctl start rigctl@RIG."
        wrong = f"{wrong}; no daemon runs on this computer"
        return Unanswered(Obstacle.PORT, wrong, "not known: no loop runs here", (_HALL, start))
    elsewhere = ", ".join(f"{one.rig} at {here(one.listen)}" for one in daemons[:2])
    there = tuple(f"rigctl status --connect {here(one.listen)}" for one in daemons[:2])
    wrong = f"{wrong}; this computer's daemon: {elsewhere}"
    if len(daemons) > 1:
        return Unanswered(Obstacle.PORT, wrong, "not known: which rig is meant is not known", there)
    return _with_slot(Obstacle.PORT, wrong, there, daemons[0])
