"""``python -m tests.bench bridge``: the Foxglove bridge on a running rig, its cost to the loop and what clients lose.

Each round, on one daemon: no bridge; the bridge at the loop's rate with its clients, one of them stalled (SIGSTOP) from
the middle on; no bridge again. ``--apart`` keeps the clients off the loop's processor, as on another computer.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
from rich.console import Console

from rigctl.bench.loop import figures
from rigctl.demo.live_rig import LiveRig
from rigctl.metrics import tension_error as metrics
from tests.bench.loop import bench_rig
from tests.bench.telemetry import RATE_HZ, SETTLE_S, add_rounds, clients_cpus, cpu_of
from tests.builders.paths import ROOT

RATIO_MAX = 1.1


def _started(words: list[str], stack: contextlib.ExitStack) -> tuple[subprocess.Popen[str], str]:
    """A process and its first line."""
    process = subprocess.Popen([sys.executable, "-m", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    stack.callback(process.wait)
    stack.callback(process.kill)
    assert process.stdout is not None
    return process, process.stdout.readline()


def _told(process: subprocess.Popen[str]) -> dict[str, int]:
    process.send_signal(signal.SIGTERM)
    assert process.stdout is not None
    return dict(json.loads(process.stdout.readline()))


def measure_served(rig: LiveRig, seconds: float, clients: int, cpus: set[int]) -> tuple[Any, dict[str, Any]]:
    """Records of the loop while the bridge serves this many clients, the last of them stalled; what they counted."""
    with contextlib.ExitStack() as stack:
        words = ["rigctl", "bridge", "foxglove", "--listen", "127.0.0.1:0", "--rate", str(RATE_HZ)]
        bridge, line = _started([*words, "--connect", rig.settings.telemetry.listen], stack)
        found = re.search(r"ws://127\.0\.0\.1:(\d+)", line)
        assert found, line
        started = [_started(["tests.bench.bridge_client", found[1]], stack)[0] for _ in range(clients)]
        for process in started:
            os.sched_setaffinity(process.pid, cpus)
        *healthy, stalled = started
        time.sleep(SETTLE_S)
        stalled.send_signal(signal.SIGSTOP)
        for process in healthy:
            process.send_signal(signal.SIGUSR1)
        used, start = cpu_of(bridge.pid), time.monotonic()
        records = rig.run(seconds)
        pct = 100.0 * (cpu_of(bridge.pid) - used) / (time.monotonic() - start)
        said = [_told(process) for process in healthy]
        stalled.send_signal(signal.SIGCONT)
        return records, {
            "received": sum(one["received"] for one in said),
            "lost": sum(one["lost"] for one in said),
            "fewest_received": min(one["received"] for one in said),
            "bridge_cpu_pct": round(pct, 1),
        }


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench bridge", description=__doc__)
    parser.add_argument("--clients", type=int, default=3, help="of the bridge, the last of them stalled")
    parser.add_argument("--minutes", type=float, default=4.0, help="with the bridge, and as much without")
    add_rounds(parser, 4)
    arguments = parser.parse_args(words)
    seconds = 60.0 * arguments.minutes / arguments.rounds
    cpus = clients_cpus(arguments.apart)
    alone, served, said = [], [], []
    with contextlib.ExitStack() as stack:
        rig = bench_rig(RATE_HZ, stack)
        for number in range(arguments.rounds):
            alone.append(rig.run(seconds / 2))
            records, counted = measure_served(rig, seconds, arguments.clients, cpus)
            served.append(records)
            said.append(counted)
            alone.append(rig.run(seconds / 2))
            print(f"round {number + 1} of {arguments.rounds}", file=sys.stderr)
    result: dict[str, Any] = {"alone": figures(alone), "served": figures(served), "clients": said}
    before, after = (
        metrics.percentiles_us(np.concatenate([one["lateness_ns"] for one in records]))["p999"]
        for records in (alone, served)
    )
    result["lateness_p999_ratio"] = ratio = round(after / max(before, 1.0), 3)
    result["lost"] = lost = sum(one["lost"] for one in said)
    console = Console(width=100)
    for what in ("alone", "served"):
        late = result[what]["lateness_us"]
        told = ", ".join(f"{name} {late[name]:.0f}" for name in ("p50", "p99", "p999", "max"))
        console.print(f"{what}: lateness us {told}; {result[what]['skipped_ticks']} ticks skipped", highlight=False)
    console.print(f"bridge: {max(one['bridge_cpu_pct'] for one in said):.1f} % of a core", highlight=False)
    received = sum(one["received"] for one in said)
    for name, figure, limit in (
        (f"records lost to the healthy of {arguments.clients} clients, of {received}", lost, 0),
        ("loop lateness p99.9, with the bridge over without", ratio, RATIO_MAX),
    ):
        met = "met" if figure <= limit else "NOT MET"
        console.print(f"{name}: {figure:g} (limit {limit:g}) {met}", highlight=False)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")
    return 0 if not lost and ratio <= RATIO_MAX else 1
