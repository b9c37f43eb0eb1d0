"""``python -m tests.bench holds``: time of HOLD while one peer floods the daemon, and whether any HOLD is lost.

The real daemon on the simulated rig, armed; each flood comes from processes of its own, on loopback. HOLD takes the
way of ``rigctl hold`` on the daemon's computer. HOLD over the network is measured too, for comparison: a flood may
block that way. A HOLD is lost if it gets no reply, or if the loop's record does not show it. An operator of this
computer commands meanwhile, TARGET or, while users flood the loop's sockets, TENSION: a command is lost if nothing
answers it. ``moved``: the longest time in ms that the loop was then in another mode than HOLD, FAULT and DISARMED;
the users' flood begins while the rig tensions.

The measuring process has a higher priority where it may (``--as-others``: the usual one): the time a command waits for
a processor of a busy computer, floods of many processes included, is no property of the way.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import pathlib
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rigctl.client import local_hold
from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Mode
from rigctl.model.verbs import COMMAND_S
from tests.bench import hung_holds
from tests.bench.flood import KINDS, TLS_KINDS, flooding
from tests.builders import daemons
from tests.live.system.test_daemon import PATIENT

LIMIT_MS, TLS_LIMIT_MS = 50.0, 100.0
OPERATOR = "kim"
NETWORK_EVERY = 10  # every tenth HOLD is repeated over the network
MOVED_MAX_MS = 50.0
USERS_HOLDS = "users_holds"
AT_REST = frozenset({Mode.HOLD, Mode.FAULT, Mode.DISARMED})
NETWORK_LOST_MAX = 2  # each takes the client's full time-out
SETTLE_S = 1.0
HUNG = "gateway_hung"  # no flood: the gateway is stopped
CALM = "none"


@dataclass(frozen=True)
class Holds:
    """Times of answered holds in ms, and the number without a reply or not in the record.

    ``taken_ms``: until the tick that carried it out, without the way of the reply.
    """

    ms: list[float]
    taken_ms: list[float]
    lost: int

    def as_dict(self) -> dict[str, Any]:
        given = len(self.ms) + self.lost
        if not self.ms:
            return {"given": given, "lost": self.lost, **dict.fromkeys(("p50_ms", "p99_ms", "max_ms", "taken_p99_ms"))}
        p50, p99 = np.percentile(self.ms, (50, 99)).tolist()
        taken = float(np.percentile(self.taken_ms, 99))
        return {"given": given, "lost": self.lost, "p50_ms": round(p50, 2), "p99_ms": round(p99, 2),
                "max_ms": round(max(self.ms), 2), "taken_p99_ms": round(taken, 2)}  # fmt: skip


class Subject:
    """A daemon on the simulated rig, and its record."""

    def __init__(self, file: pathlib.Path) -> None:
        self.file = file
        self.endpoint, self.rig = daemons.endpoint(file), daemons.name_of(file)
        self.key, self.floods_key = daemons.key_of(OPERATOR, file), daemons.key_of("lee", file)
        self._left_ns: int | None = None  # since when the loop is in another mode than those at rest
        self._records, self._all = Runtime.of(self.rig).records.reader(), Runtime.of(self.rig).records.reader()

    def hold(self) -> tuple[float, float] | None:
        """Milliseconds until the reply to HOLD, and until the tick that carried it out; None if no record shows it."""
        before, start = self._taken(), time.monotonic_ns()
        answer = local_hold.hold(self.endpoint, self.rig, OPERATOR)
        passed_ms = (time.monotonic_ns() - start) / 1e6
        if answer is None or not answer["accepted"] or answer["mode"] != "HOLD" or self._taken() <= before:
            return None
        return passed_ms, (answer["t_ns"] - start) / 1e6

    def moved_ms(self, since_ns: int) -> float:
        """Longest time out of HOLD, FAULT and DISARMED in the records since the last call, by the loop's own ticks.

        ``since_ns``: the flood's start; what was before does not count.
        """
        longest, new = 0, self._all.read()
        for mode, t_ns in zip(new["mode"].tolist(), new["t_ns"].tolist(), strict=True):
            self._left_ns = None if mode in AT_REST else max(self._left_ns or t_ns, since_ns)
            longest = max(longest, t_ns - (self._left_ns or t_ns))
        return longest / 1e6

    def tension(self, operator: Client) -> None:
        """Leave HOLD, so that a flood of HOLD has something to end."""
        answer = operator.command("tension", OPERATOR)
        if not answer["accepted"] or answer["mode"] != Mode.TENSIONING.name:
            raise RuntimeError(f"TENSION was not taken: {answer}")

    def _taken(self) -> int:
        record = self._records.latest()
        return int(record["hold_seq"]) if record is not None else 0

    def gateway(self) -> int:
        return daemons.process_with("rigctl.gateway.gateway_process", f"rigctl-{self.rig}")

    def gateway_mib(self) -> float:
        for line in pathlib.Path(f"/proc/{self.gateway()}/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 1024
        return 0.0


@contextlib.contextmanager
def subject(*, tls: bool = False, page: bool = False) -> Iterator[Subject]:
    """The paper's rig with its own name, endpoint and folders, armed; ``tls``: with certificates."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        file = daemons.rig_file(folder, PATIENT)
        if page:
            file.write_text(f'{file.read_text()}\npage: {{listen: "127.0.0.1:{daemons.free_port()}"}}\n')
        if tls:
            daemons.with_certificates(file)
        stack.enter_context(daemons.simulated_rig(file, folder / "rig.log"))
        stack.enter_context(daemons.daemon(file, folder / "daemon.log"))
        armed = daemons.rigctl("arm", file=file)
        if armed.returncode:
            raise RuntimeError(armed.stderr)
        yield Subject(file)


@contextlib.contextmanager
def hung(subject: Subject) -> Iterator[None]:
    """Stop the gateway within the context; the supervisor replaces it meanwhile."""
    pid = subject.gateway()
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def _over_network(client: Client) -> tuple[float, float] | None:
    start = time.monotonic_ns()
    try:
        answer = client.command("hold", OPERATOR)
    except NoDaemonError:
        return None
    return ((time.monotonic_ns() - start) / 1e6, (answer["t_ns"] - start) / 1e6) if answer["accepted"] else None


def _commanded(client: Client, kind: str) -> bool:
    """Whether a command of the operator's is answered, be it that another has his lease."""
    try:
        client.command(*(("tension", OPERATOR) if kind == USERS_HOLDS else ("target", OPERATOR, 300.0)))
    except NoDaemonError:
        return False
    return True


def measure(rig: Subject, kind: str, count: int, pause_s: float) -> dict[str, Any]:
    """``count`` holds at irregular times while the flood lasts."""
    chance, moved_ms, commanded = random.Random(kind), 0.0, list[bool]()
    local: list[tuple[float, float] | None] = []
    remote: list[tuple[float, float] | None] = []
    seconds = count * pause_s * 1.5 + NETWORK_LOST_MAX * COMMAND_S + 15.0
    with contextlib.ExitStack() as stack:
        network = None
        with contextlib.suppress(NoDaemonError, ChoiceError):
            if rig.key is not None:  # without one there is no HOLD over the network
                network = stack.enter_context(Client(rig.endpoint, rig.rig, key=rig.key))
        operator = None
        if rig.key is None and kind != HUNG:
            operator = stack.enter_context(Client(rig.endpoint, rig.rig))
            operator.take_lease(OPERATOR, "bench")
        child = None
        if kind == HUNG:
            network = None
            stack.enter_context(hung(rig))
        elif kind != CALM:
            if kind == USERS_HOLDS and operator is not None:
                rig.tension(operator)
            child = stack.enter_context(flooding(kind, rig.endpoint, rig.rig, seconds, rig.floods_key))
        since_ns = time.monotonic_ns()
        time.sleep(SETTLE_S)
        moved_ms = max(moved_ms, rig.moved_ms(since_ns))
        for number in range(count):
            local.append(rig.hold())
            if operator is not None and number % NETWORK_EVERY == 0:
                commanded.append(_commanded(operator, kind))
            moved_ms = max(moved_ms, rig.moved_ms(since_ns))
            if network is not None and number % NETWORK_EVERY == 0 and remote.count(None) < NETWORK_LOST_MAX:
                remote.append(_over_network(network))
            time.sleep(chance.uniform(0.5, 1.5) * pause_s)
        alive = child is None or child.poll() is None
    return {"flood": kind, **_holds(local).as_dict(), "network": _holds(remote).as_dict(), "flood_lasted": alive,
            "commands": len(commanded), "commands_lost": commanded.count(False), "moved_ms": round(moved_ms, 1),
            "gateway_peak_mib": round(rig.gateway_mib(), 1)}  # fmt: skip


def _holds(found: list[tuple[float, float] | None]) -> Holds:
    good = [one for one in found if one is not None]
    return Holds([one for one, _ in good], [taken for _, taken in good], found.count(None))


def met(row: dict[str, Any], limit_ms: float) -> bool:
    stayed = row["flood"] != USERS_HOLDS or row["moved_ms"] <= MOVED_MAX_MS
    return bool(
        stayed
        and row["flood_lasted"]
        and not row["lost"]
        and not row["commands_lost"]
        and row["p99_ms"] is not None
        and row["p99_ms"] <= limit_ms
    )


def show(rows: list[dict[str, Any]], limit_ms: float, console: Console) -> None:
    table = Table(
        "flood",
        "holds",
        "lost",
        "p50 ms",
        "p99 ms",
        "max ms",
        "taken p99",
        "commands lost",
        "moved ms",
        "network lost",
        "p50",
        "max",
        "",
        box=None,
    )
    for row in rows:
        there = row["network"]
        figures = (str(row[name]) for name in ("given", "lost", "p50_ms", "p99_ms", "max_ms", "taken_p99_ms"))
        table.add_row(
            row["flood"], *figures, f"{row['commands_lost']} of {row['commands']}", str(row["moved_ms"]),
            f"{there['lost']} of {there['given']}", str(there["p50_ms"]), str(there["max_ms"]),
            "met" if met(row, limit_ms) else "NOT MET",
        )  # fmt: skip
    console.print(table, highlight=False)
    peak = max((row["gateway_peak_mib"] for row in rows), default=0.0)
    console.print(f"limits: HOLD p99 {limit_ms:g} ms, 0 lost; gateway's memory at most {peak:.0f} MiB", highlight=False)


def _hung(count: int, file: pathlib.Path | None) -> int:
    with subject(page=True) as rig:
        rows = hung_holds.measure(rig.file, count)
    hung_holds.show(rows, Console(width=110))
    if file is not None:
        file.write_text(json.dumps({"factor": hung_holds.FACTOR, "stopped": rows}, indent=2) + "\n")
    return 0 if all(row["met"] for row in rows) else 1


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench holds", description=__doc__)
    parser.add_argument("--floods", nargs="+", choices=[CALM, *TLS_KINDS, HUNG], help="[all]")
    parser.add_argument("--tls", action="store_true", help="a daemon with certificates; the flood has an operator's")
    parser.add_argument("--count", type=int, default=200, help="holds under each flood")
    parser.add_argument("--pause", type=float, default=0.05, help="seconds between them, about")
    parser.add_argument("--as-others", action="store_true", help="wait for a processor like every other process")
    parser.add_argument("--hung", action="store_true", help="instead: rigctl hold with each other process stopped")
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    arguments = parser.parse_args(words)
    if arguments.hung:
        return _hung(arguments.count, arguments.json)
    rows = []
    if not arguments.as_others:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    limit_ms = TLS_LIMIT_MS if arguments.tls else LIMIT_MS
    with subject(tls=arguments.tls) as rig:
        for kind in arguments.floods or [CALM, *(TLS_KINDS if arguments.tls else KINDS), HUNG]:
            rows.append(measure(rig, kind, arguments.count, arguments.pause))
            print(f"{kind}: p99 {rows[-1]['p99_ms']} ms, {rows[-1]['lost']} lost", file=sys.stderr)
    show(rows, limit_ms, Console(width=130))
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"limit_p99_ms": limit_ms, "tls": arguments.tls, "floods": rows}, indent=2) + "\n"
        )
    return 0 if all(met(row, limit_ms) for row in rows) else 1
