"""``python -m tests.bench.recorder [--kills N] [--seed S] [--json F]``: the recorder of a running daemon is killed.

Rig and daemon are real, the loop runs at 1 kHz; the recorder gets SIGKILL at random instants. For each kill: how much
of the time before it is missing in the killed recorder's file (the next recorder takes it from the rings), how much is
lost, because the whole recording lacks it, and whether the file is readable. Exit code 0 good, 1 more than a second is
lost or a file cannot be read.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import random
import signal
import statistics
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.recorder import parts, recording
from tests.builders import daemons
from tests.builders.waiting import until

LIMIT_MS = 1000.0
LONGEST_WAIT_S = 3.0
PATIENT: dict[str, dict[str, Any]] = {
    "safety": {
        "stale_ms": 100,
        "bus_silent_ms": 100,
        "inclination_stale_ms": 500,
        "overrun_ticks": 900,
        "waiver": "a simulated rig on a busy machine",
    },
    "cylinder": {"command_deadline_ms": 150, "heartbeat_timeout_ms": 200},
}
"""A daemon that does not trip on a machine shared with other work; its timing is not judged here."""


@dataclass(frozen=True)
class Kill:
    """One kill. ``file_ms``: time before it that the killed recorder's file lacks; ``lost_ms``: missing for good."""

    t_ns: int
    file: str
    file_ms: float
    lost_ms: float
    readable: bool


def strike(file: pathlib.Path, chance: random.Random, longest_s: float = LONGEST_WAIT_S) -> tuple[int, str]:
    """Kill the recorder of the daemon of ``file`` after a random time; returns the instant and the file it wrote."""
    runtime = Runtime.of(daemons.name_of(file))

    def writing() -> tuple[int, str] | None:
        told = runtime.read_json(RECORDED)
        name = (told.get("recording") or {}).get("file")
        alive = pathlib.Path(f"/proc/{told.get('pid', 0)}/stat").exists()
        return (int(told["pid"]), str(name)) if name and alive and told["recording"]["records"] else None

    until(writing)
    time.sleep(chance.uniform(0.0, longest_s))
    pid, name = until(writing)
    t_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    until(lambda: runtime.read_json(RECORDED).get("pid") != pid)
    return t_ns, name


def judged(settings: RigSettings, struck: list[tuple[int, str]]) -> list[Kill]:
    """Examine the files of a daemon that has ended."""
    folder = settings.file(settings.recording.folder)
    everything = [part.path for part in parts.parts(folder, settings.rig)]
    whole = recording.read(*everything)
    tick_ms = settings.loop.period_ns * 1e-6
    found = []
    for t_ns, name in struck:
        try:
            alone = recording.read(folder / name)
            file_ms, readable = (t_ns - alone.end_ns) * 1e-6, len(alone.records) > 0
        except recording.RecordingError:
            file_ms, readable = float("inf"), False
        near = [gap for gap in whole.gaps if gap.ring == "records" and abs(gap.t_ns - t_ns) < 20e9]
        found.append(Kill(t_ns, name, round(file_ms, 1), sum(gap.count for gap in near) * tick_ms, readable))
    return found


def play(count: int, seed: int) -> dict[str, Any]:
    """``count`` kills, as figures."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="rigctl-recorder-") as name:
        folder = pathlib.Path(name)
        file = daemons.rig_file(folder, PATIENT)
        log = folder / "daemon.log"
        struck = []
        with daemons.simulated_rig(file, folder / "rig.log"), daemons.daemon(file, log):
            for number in range(count):
                struck.append(strike(file, chance))
                print(f"\r{number + 1} of {count}", end="", file=sys.stderr, flush=True)
            print(file=sys.stderr)
            told = Runtime.of(daemons.name_of(file)).read_json(RECORDED)["recording"]
        settings = config.load(file)
        kills = judged(settings, struck)
        whole = recording.read(*(part.path for part in parts.parts(settings.file("recordings"), settings.rig)))
    missing = [kill.file_ms for kill in kills]
    return {
        "kills": len(kills), "seed": seed, "files": len(whole.files), "records": len(whole.records),
        "readable": sum(kill.readable for kill in kills),
        "file_ms": {"median": statistics.median(missing), "max": max(missing)},
        "lost_ms": {"max": max(kill.lost_ms for kill in kills)},
        "gaps": [asdict(gap) for gap in whole.gaps],
        "kb_s": round(sum(f.size for f in whole.files) / 1e3 / max((whole.end_ns - whole.start_ns) * 1e-9, 1e-9), 1),
        "ticks_ascend": bool(np.all(np.diff(whole.records["tick"].astype(np.int64)) >= 1)),
        "last": told, "each": [asdict(kill) for kill in kills],
        "ok": all(k.readable and k.lost_ms <= LIMIT_MS for k in kills),
    }  # fmt: skip


def main() -> int:
    """Parse the command line, play, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.recorder", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=pathlib.Path, metavar="F", help="write the figures here")
    asked = parser.parse_args()
    if asked.kills < 1:
        parser.error(f"--kills: found {asked.kills}, expected 1 or more")
    found = play(asked.kills, asked.seed)
    for number, kill in enumerate(found["each"], 1):
        mark = "" if kill["readable"] else "  NOT READABLE"
        print(
            f"{number:4d}  file lacks {kill['file_ms']:7.1f} ms  lost {kill['lost_ms']:7.1f} ms  {kill['file']}{mark}"
        )
    print(f"{found['kills']} kills, {found['readable']} files readable, {found['files']} parts")
    print(
        f"lacking in the killed file: median {found['file_ms']['median']:.1f} ms, max {found['file_ms']['max']:.1f} ms"
    )
    print(f"lost for good: max {found['lost_ms']['max']:.1f} ms (limit {LIMIT_MS:g} ms), {len(found['gaps'])} gaps")
    print("good" if found["ok"] else "BAD")
    if asked.json is not None:
        asked.json.write_text(json.dumps(found, indent=1) + "\n")
    return 0 if found["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
