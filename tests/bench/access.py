"""``python -m tests.bench access``: certificates and access lists for as long as a client runs.

A gateway that listens with certificates, fed by a stand-in for the loop. Subscribers of every role, each a process,
receive every record; one client declares its subscriptions anew every second and must get data each time; an operator
commands every second; the access list changes now and then, which starts the gateway anew. Access lists are known that
drop renewed subscriptions without a word, after minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import pathlib
import subprocess
import sys
import time
from typing import Any

from rich.console import Console

from rigctl.client.connection import Client
from rigctl.identity.roles import Role
from tests.bench.telemetry import cpu_of
from tests.builders.certified import NAMES, CertifiedDaemon
from tests.builders.paths import ROOT

GATEWAY_CPU_PCT = 30.0
TURN_S = 1.0
COME_S = 10.0  # within which data come after a subscription, also while the gateway is started anew


def _counter(daemon: CertifiedDaemon, name: str, stack: contextlib.ExitStack) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "rigctl.client.counter", "--connect", daemon.endpoint],
        cwd=ROOT, stdout=subprocess.PIPE, text=True, env={**os.environ, "RIGCTL_KEY": str(daemon.key(name))},
    )  # fmt: skip
    stack.callback(process.wait)
    stack.callback(process.kill)
    assert process.stdout is not None
    if not process.stdout.readline():
        raise RuntimeError("a subscriber ended before the first block")
    return process


def _renewed(client: Client) -> bool:
    """Whether states and records come on subscriptions just declared; they end here."""
    states, blocks = client.follow(client.keys.state), client.blocks()
    until = time.monotonic() + COME_S
    come = states.read(COME_S) is not None
    while come and not list(blocks.arrived()):
        come = time.monotonic() < until
        blocks.wait(0.1)
    states.close()
    blocks.close()
    return come


def measure(seconds: float, clients: int, changes: int) -> dict[str, Any]:
    """``changes``: of the access list, spread over the time."""
    daemon = CertifiedDaemon()
    with contextlib.ExitStack() as stack:
        stack.callback(daemon.close)
        daemon.start_loop()
        daemon.start_gateway()
        kim = stack.enter_context(daemon.client_of("kim"))
        vera = stack.enter_context(daemon.client_of("vera"))
        counters = [_counter(daemon, list(NAMES)[i % len(NAMES)], stack) for i in range(clients)]
        start = time.monotonic()
        found = {"renewals": 0, "renewals_silent": 0, "commands": 0, "commands_refused": 0, "changes": 0}
        used_s, cpu_s = 0.0, 0.0
        while (elapsed := time.monotonic() - start) < seconds:
            if found["changes"] < changes and elapsed > seconds * (found["changes"] + 1) / (changes + 1):
                found["changes"] += 1
                daemon.keys.add(f"eva{found['changes']}", Role.VIEWER)
                daemon.renewed_gateway()
                daemon.client_of("kim").close()
            assert daemon.gateway is not None
            before, began = cpu_of(daemon.gateway.pid), time.monotonic()
            found["renewals"] += 1
            found["renewals_silent"] += not _renewed(vera)
            found["commands"] += 1
            found["commands_refused"] += not kim.command("target", "kim", 250.0 + found["commands"] % 50)["accepted"]
            time.sleep(max(0.0, TURN_S - (time.monotonic() - began)))
            cpu_s += cpu_of(daemon.gateway.pid) - before
            used_s += time.monotonic() - began
        counts = []
        for process in counters:
            process.terminate()
            assert process.stdout is not None
            counts.append(json.loads(process.stdout.readline()))
    return {
        **found,
        "seconds": round(seconds, 1),
        "clients": clients,
        "gateway_cpu_pct": round(100 * cpu_s / used_s, 1),
        "lost": sum(one["lost"] for one in counts),
        "recovered": sum(one["recovered"] for one in counts),
        "fewest_received": min((one["received"] for one in counts), default=0),
    }


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench access", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--clients", type=int, default=10)
    parser.add_argument("--changes", type=int, default=3, help="of the access list meanwhile")
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    arguments = parser.parse_args(words)
    found = measure(arguments.seconds, arguments.clients, arguments.changes)
    Console(width=100).print("\n".join(f"{name}: {value}" for name, value in found.items()), highlight=False)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2) + "\n")
    bad = [name for name in ("lost", "renewals_silent", "commands_refused") if found[name]]
    bad += ["gateway_cpu_pct"] if found["gateway_cpu_pct"] > GATEWAY_CPU_PCT else []
    print(f"NOT MET: {', '.join(bad)}" if bad else "met")
    return 1 if bad else 0
