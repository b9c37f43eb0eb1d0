"""``python -m tests.bench telemetry``: subscribers on a running rig, their cost to the loop and the data they receive.

Each round, on one daemon: no listener, three clients, all clients with one more stalled (SIGSTOP), no listener again.
``--apart`` keeps the clients off the loop's processor, as if it were isolated or they ran on another computer: with a
kernel that is not preempted in a system call, the loop waits for the clients' calls.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rigctl.bench.loop import figures
from rigctl.config import rig_file as config
from rigctl.demo.live_rig import LiveRig
from rigctl.metrics import tension_error as metrics
from tests.bench.loop import bench_rig
from tests.bench.subscriber import BIN_US, BINS
from tests.builders import daemons
from tests.builders.paths import ROOT

RATE_HZ = 1000
SETTLE_S = 3.0  # excludes the start of the interpreters from all figures
LIMITS = {"lateness_p999_ratio": 1.1, "gateway_cpu_pct": 20.0, "age_p50_ms": 30.0, "age_p99_ms": 60.0}


class Subscribers:
    """Subscriber processes, every third of them without our client."""

    def __init__(self, endpoint: str, number: int, stalled: int, cpus: set[int], stack: contextlib.ExitStack) -> None:
        self._cpus = cpus
        self._processes = [self._start(endpoint, index % 3 == 2, stack) for index in range(number)]
        self._stalled = [self._start(endpoint, False, stack) for _ in range(stalled)]
        for process in self._processes + self._stalled:
            assert process.stdout is not None
            if not process.stdout.readline():
                raise RuntimeError("a subscriber ended before the first block")
        for process in self._stalled:
            process.send_signal(signal.SIGSTOP)
        time.sleep(SETTLE_S)
        for process in self._processes:
            process.send_signal(signal.SIGUSR1)

    def _start(self, endpoint: str, plain: bool, stack: contextlib.ExitStack) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "tests.bench.subscriber", endpoint, *(["--plain"] if plain else [])]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        os.sched_setaffinity(process.pid, self._cpus)
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process

    def end(self) -> dict[str, Any]:
        """Results of the processes: counts in total, ages in bins, and those of the stalled ones once continued."""
        told = [self._told(process) for process in self._processes]
        for process in self._stalled:
            process.send_signal(signal.SIGCONT)
        if self._stalled:
            time.sleep(SETTLE_S)  # they read what is still held for them
        stalled = [self._told(process)["count"] for process in self._stalled]
        bins = np.zeros(BINS, np.int64)
        for one in told:
            for number, count in one["ages"].items():
                bins[int(number)] += count
        names = ("received", "lost", "recovered")
        return {
            "clients": len(told),
            **{name: sum(one["count"][name] for one in told) for name in names},
            "fewest_received": min((one["count"]["received"] for one in told), default=0),
            "stalled": [{name: count[name] for name in names} for count in stalled],
            "bins": bins,
        }

    @staticmethod
    def _told(process: subprocess.Popen[str]) -> dict[str, Any]:
        process.send_signal(signal.SIGTERM)
        assert process.stdout is not None
        return dict(json.loads(process.stdout.readline()))


@dataclass
class Slice:
    """One stretch of a round."""

    what: str
    records: Any
    gateway_cpu_pct: float
    said: dict[str, Any] | None


def cpu_of(pid: int) -> float:
    words = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def measure_slice(rig: LiveRig, what: str, seconds: float, clients: int, stalled: int, cpus: set[int]) -> Slice:
    """Record ``seconds`` of the loop while this many clients listen, on these processors."""
    with contextlib.ExitStack() as stack:
        subscribers = Subscribers(rig.settings.telemetry.listen, clients, stalled, cpus, stack) if clients else None
        time.sleep(SETTLE_S)
        gateway = daemons.process_with("rigctl.gateway.gateway_process", f"rigctl-{rig.settings.rig}")
        used, start = cpu_of(gateway), time.monotonic()
        records = rig.run(seconds)
        pct = 100.0 * (cpu_of(gateway) - used) / (time.monotonic() - start)
        return Slice(what, records, pct, subscribers.end() if subscribers is not None else None)


def percentile_ms(bins: np.ndarray[Any, np.dtype[np.int64]], q: float) -> float:
    """Upper edge of the bin that holds the quantile; 0 without data."""
    whole = int(bins.sum())
    number = int(np.searchsorted(np.cumsum(bins), q * whole)) if whole else -1
    return (number + 1) * BIN_US / 1000.0


def judged(slices: list[Slice]) -> dict[str, Any]:
    """Figures of all rounds, by kind of listeners."""
    result: dict[str, Any] = {}
    for what in dict.fromkeys(one.what for one in slices):
        of = [one for one in slices if one.what == what]
        result[what] = figures([one.records for one in of])
        result[what]["gateway_cpu_pct"] = round(float(np.mean([one.gateway_cpu_pct for one in of])), 1)
        said = [one.said for one in of if one.said is not None]
        if said:
            bins = sum((one["bins"] for one in said), np.zeros(BINS, np.int64))
            result[what]["age_ms"] = {n: percentile_ms(bins, q) for n, q in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))}
            result[what] |= {n: sum(one[n] for one in said) for n in ("received", "lost", "recovered")}
            result[what]["stalled"] = [count for one in said for count in one["stalled"]]
    nobody, everybody = (metrics.percentiles_us(_lateness(slices, what))["p999"] for what in ("nobody", "all"))
    result["lateness_p999_ratio"] = round(everybody / max(nobody, 1.0), 3)
    return result


def _lateness(slices: list[Slice], what: str) -> Any:
    return np.concatenate([one.records["lateness_ns"] for one in slices if one.what == what])


def verdicts(result: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Name, figure and limit of each promise."""
    everybody, three = result["all"], result["three"]
    return [
        ("samples lost to healthy clients", everybody["lost"] + three["lost"], 0),
        ("loop lateness p99.9, all over nobody", result["lateness_p999_ratio"], LIMITS["lateness_p999_ratio"]),
        ("gateway CPU with three clients, % of a core", three["gateway_cpu_pct"], LIMITS["gateway_cpu_pct"]),
        ("sample to callback p50, ms", everybody["age_ms"]["p50"], LIMITS["age_p50_ms"]),
        ("sample to callback p99, ms", everybody["age_ms"]["p99"], LIMITS["age_p99_ms"]),
    ]


def show(result: dict[str, Any], console: Console) -> None:
    table = Table("listening", "", "p50", "p99", "p99.9", "max", "", box=None)
    for what in ("nobody", "three", "all"):
        one, late = result[what], result[what]["lateness_us"]
        table.add_row(what, "loop lateness us", *(f"{late[name]:.0f}" for name in ("p50", "p99", "p999", "max")),
                      f"{one['skipped_ticks']} of {one['ticks']} ticks skipped")  # fmt: skip
        if ages := one.get("age_ms"):
            p50, p99, most = (f"{ages[name]:.1f}" for name in ("p50", "p99", "max"))
            lost = f"{one['lost']} of {one['received']} samples lost"
            table.add_row("", "age at callback ms", p50, p99, "", most, lost)
        table.add_row("", f"gateway {one['gateway_cpu_pct']:.1f} % of a core")
    console.print(table, highlight=False)
    for count in result["all"]["stalled"]:
        console.print(f"stalled, running again: {', '.join(f'{n} {v}' for n, v in count.items())}", highlight=False)
    for name, figure, limit in verdicts(result):
        console.print(
            f"{name}: {figure:g} (limit {limit:g}) {'met' if figure <= limit else 'NOT MET'}", highlight=False
        )


def add_rounds(parser: argparse.ArgumentParser, rounds: int) -> None:
    """The options of a bench that measures in rounds, with clients and without."""
    parser.add_argument("--rounds", type=int, default=rounds, help="in which this is done")
    parser.add_argument("--apart", action="store_true", help="keep the clients off the loop's processor")
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")


def clients_cpus(apart: bool) -> set[int]:
    """The processors of the clients: all, or all but the loop's."""
    cpus = os.sched_getaffinity(0)
    return cpus - {config.load(daemons.PAPER).loop.cpu} if apart else cpus


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench telemetry", description=__doc__)
    parser.add_argument("--clients", type=int, default=10, help="healthy ones")
    parser.add_argument("--stalled", type=int, default=1, help="and so many stopped in the middle")
    parser.add_argument("--minutes", type=float, default=10.0, help="with all of them, and as much with nobody")
    add_rounds(parser, 2)
    arguments = parser.parse_args(words)
    seconds = 60.0 * arguments.minutes / arguments.rounds
    plan = (("nobody", seconds / 2, 0, 0), ("three", seconds / 4, 3, 0),
            ("all", seconds, arguments.clients, arguments.stalled), ("nobody", seconds / 2, 0, 0))  # fmt: skip
    console = Console(width=100)
    cpus = clients_cpus(arguments.apart)
    slices = []
    with contextlib.ExitStack() as stack:
        rig = bench_rig(RATE_HZ, stack)
        for number in range(arguments.rounds):
            for what, length, clients, stalled in plan:
                slices.append(measure_slice(rig, what, length, clients, stalled, cpus))
                print(f"round {number + 1}: {what}, {length:.0f} s", file=sys.stderr)
    result = judged(slices)
    show(result, console)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")
    return 0 if all(figure <= limit for _, figure, limit in verdicts(result)) else 1
