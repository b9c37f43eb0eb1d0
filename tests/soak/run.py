"""One soak: a daemon on the simulated rig in processes of its own, with everything at once, and the figures of it."""

from __future__ import annotations

import contextlib
import os
import pathlib
import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rigctl.client.connection import Client, NoDaemonError
from rigctl.control.events import Kind
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.recorder import parts, recording
from tests.bench.recorder import PATIENT
from tests.builders import daemons
from tests.soak import judge, plan
from tests.soak.load import Commander, Listener, Onlooker, PageReader, Visitors, filled, small_disk
from tests.soak.pauses import Pauses
from tests.soak.sampling import Lateness, Life, Processes, children

PARTS_MB, KEEP_MB, FREE_MIB, DISK_MIB = 16, 64, 16, 160
BACK_S = 30.0
POLL_S = 0.25
SAMPLES = 2000  # of each process, at most
RIG = "simulated rig"


def _loop_of(daemon: int) -> dict[str, int]:
    pid = children(daemon).get("control")
    return {"the loop": pid} if pid is not None else {}


class Soak:
    """A running soak."""

    def __init__(self, duration_s: float, seed: int, folder: pathlib.Path, say: Callable[[str], None]) -> None:
        self._duration_s, self._seed, self._folder, self._say = duration_s, seed, folder, say
        self._chance = random.Random(seed)
        self._struck: list[dict[str, Any]] = []
        self._not_back: list[str] = []
        self._events: dict[tuple[int, str], dict[str, Any]] = {}

    def run(self) -> tuple[dict[str, Any], list[judge.Slope], Processes]:
        """Play it; returns figures, fits and samples."""
        with small_disk(self._folder / "disk", DISK_MIB, subprocess.run) as disk:
            return self._on(disk)

    def _on(self, disk: pathlib.Path | None) -> tuple[dict[str, Any], list[judge.Slope], Processes]:
        page = f"localhost:{daemons.free_port()}"  # an address in numbers would need quotes in the rig file
        kept: dict[str, Any] = {"part_mb": PARTS_MB, "keep_mb": KEEP_MB, "free_mib": FREE_MIB}
        changes: dict[str, dict[str, Any]] = {
            **PATIENT,
            "preflight": {"disk_free_mib": 1},
            "recording": kept | ({"folder": str(disk)} if disk is not None else {}),
            "page": {"listen": page},
        }
        file, log = daemons.rig_file(self._folder, changes), self._folder / "daemon.log"
        name, endpoint = daemons.name_of(file), daemons.endpoint(file)
        with daemons.simulated_rig(file, self._folder / "rig.log") as rig, daemons.daemon(file, log) as daemon:
            runtime = Runtime.of(name)
            processes, lateness = Processes(daemon.pid, {RIG: rig.pid}), Lateness(runtime.records.reader())
            commander = Commander(endpoint, name, random.Random(self._seed + 1))
            visitors = Visitors(endpoint, name, random.Random(self._seed + 2))
            listener, reader, onlooker = Listener(endpoint, name), PageReader(page), Onlooker(page)
            load = (commander, visitors, listener, reader, onlooker)
            for worker in load:
                worker.start()
            pauses, start = Pauses(lambda: {RIG: rig.pid, **_loop_of(daemon.pid)}), time.monotonic()
            recorded = self._play(daemon.pid, runtime, disk, processes, lateness, load)
            for worker in load:
                worker.end()
            pauses.end()
            self._take_events(endpoint, name)
            daemon.send_signal(signal.SIGTERM)
            code = daemon.wait(60.0)
        whole = self._recording(disk if disk is not None else self._folder / "recordings")
        trips = [event for event in self._events.values() if event.get("kind") == Kind.TRIP.name]
        control_ns = [strike["t_ns"] for strike in self._struck if strike["what"] == "control"]
        if onlooker.memory:
            seen = [(at - start, mib, 0) for at, mib in onlooker.memory]
            processes.lives.append(Life("scripts", 0, seen))
        results: dict[str, Any] = {
            "duration_s": self._duration_s,
            "seed": self._seed,
            "strikes": self._struck,
            "not_back": self._not_back,
            "daemon_exit": code,
            "commands": {**Counter(accepted=0, refused=0, unanswered=0), **commander.counts},
            "refusals": dict(commander.reasons.most_common(20)),
            "clients_came": visitors.came,
            "page": {"frames": reader.frames, "opened": reader.opened},
            "listener_received": listener.received,
            "records": lateness.records,
            "lost": {
                "records_lost_by_the_recorder": recorded["records"],
                "frames_lost_by_the_recorder": recorded["frames"],
                "records_lost_by_a_listener": listener.lost,
                "records_missed_in_the_ring": lateness.gaps,
                "records_missing_in_the_recording": whole["missing"],
            },
            "recording_read_s": whole["read_s"],
            "trips": judge.explained(trips, control_ns, pauses.seen),
            "pauses": {"count": len(pauses.seen), "longest_ms": max((one.ms for one in pauses.seen), default=0.0)},
            "browser": {"there": onlooker.there, "draws": onlooker.draws, "errors": sorted(onlooker.errors)},
            "lateness": lateness.figures(),
            "disk_filled": disk is not None,
            "workers": {worker.name: worker.error for worker in load if worker.error},
        }
        slopes = [fit for fit in map(judge.slope, processes.lives) if fit is not None]
        results["processes"] = [asdict(fit) for fit in slopes]
        results["samples"] = [
            {"name": one.name, "pid": one.pid, "s_mib_handles": one.table.round(2).tolist()} for one in processes.lives
        ]
        results["broken"] = judge.broken(results, slopes)
        return results, slopes, processes

    def _play(
        self, supervisor: int, runtime: Runtime, disk: pathlib.Path | None,
        processes: Processes, lateness: Lateness, load: tuple[Any, ...],
    ) -> Counter[str]:  # fmt: skip
        begin, end = plan.busy(self._duration_s)
        due = plan.strikes(self._duration_s, self._chance)
        every = max(POLL_S, self._duration_s / SAMPLES)
        start, sampled, said = time.monotonic(), -every, 0.0
        losses: dict[int, tuple[int, int]] = {}
        while (now := time.monotonic() - start) < self._duration_s:
            busy = begin <= now < end
            for worker in load:
                (worker.active.set if busy else worker.active.clear)()
            if busy and due and now >= due[0].at_s:
                self._strike(due.pop(0), supervisor, disk, now)
            if now - sampled >= every:
                sampled = now
                processes.sample(now)
                written = runtime.known(RECORDED)
                told = written.get("recording") or {}
                losses[int(written.get("pid", 0))] = (told.get("records_lost", 0), told.get("frames_lost", 0))
            if busy and now - said >= min(60.0, self._duration_s / 6):
                said = now
                self._take_events(str(load[0]._endpoint), str(load[0]._rig))
                self._say(f"{now:.0f} s: {lateness.records} records, {len(self._struck)} strikes")
            lateness.follow("busy" if busy else "alone")
            time.sleep(POLL_S)
        until = time.monotonic() + BACK_S
        while (gone := {*plan.VICTIMS} - children(supervisor).keys()) and time.monotonic() < until:
            time.sleep(POLL_S)
        self._not_back += sorted(gone)
        return Counter(
            records=sum(records for records, _ in losses.values()), frames=sum(frames for _, frames in losses.values())
        )

    def _strike(self, strike: plan.Strike, supervisor: int, disk: pathlib.Path | None, now: float) -> None:
        self._struck.append({"what": strike.what, "at_s": round(now, 1), "t_ns": time.monotonic_ns()})
        if strike.what == "disk":
            if disk is not None:
                with filled(disk):
                    time.sleep(plan.DISK_FULL_S)
            return
        pid = children(supervisor).get(strike.what)
        if pid is None:
            self._not_back.append(strike.what)
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)

    def _take_events(self, endpoint: str, name: str) -> None:
        """Keep the events that the daemon still holds: the ring has room for 4096."""
        with contextlib.suppress(NoDaemonError), Client(endpoint, name) as client:
            for event in client.past_events():
                self._events[int(event.get("t_ns", 0)), str(event.get("text"))] = dict(event)

    def _recording(self, folder: pathlib.Path) -> dict[str, float]:
        """Records missing in the recording as it was kept, and the time it covers."""
        files = sorted(folder.glob("*.mcap"))
        if not files:
            return {"missing": 1, "read_s": 0.0}
        found = recording.read(*parts.of_same_run(files[-1]), frames=False)
        seq = found.records["seq"].astype(int)
        missing = int(seq[-1] - seq[0] + 1 - len(seq))
        return {"missing": missing, "read_s": round((found.end_ns - found.start_ns) * 1e-9, 1)}
