"""One soak: everything at once on a daemon with the simulated rig, and the figures of it."""

from __future__ import annotations

import contextlib
import os
import pathlib
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rigctl.client.connection import Client, NoDaemonError
from rigctl.ipc.runtime_folder import RECORDED
from rigctl.model.events import Kind
from rigctl.recorder import parts, recording
from tests.soak import judge, plan
from tests.soak.load import Commander, Listener, Onlooker, PageReader, Visitors, Worker, filled
from tests.soak.pauses import Pauses
from tests.soak.sampling import Lateness, Life, Processes
from tests.soak.subject import RIG, Subject

BACK_S = 30.0
POLL_S = 0.25
SAMPLES = 2000  # of each process, at most


def _timely(pids: dict[str, int]) -> dict[str, int]:
    """The processes whose pause makes the rig trip, and the gateway, which has to be back before the ring is full."""
    watched = ((RIG, f"the {RIG}"), ("control", "the loop"), ("gateway", judge.GATEWAY))
    return {words: pids[name] for name, words in watched if name in pids}


class Soak:
    """A running soak."""

    def __init__(self, duration_s: float, seed: int, say: Callable[[str], None]) -> None:
        self._duration_s, self._seed, self._say = duration_s, seed, say
        self._chance = random.Random(seed)
        self._struck: list[dict[str, Any]] = []
        self._not_back: list[str] = []
        self._events: dict[tuple[int, str], dict[str, Any]] = {}
        self._overwritten = 0  # records that the ring no longer held when a gateway was back

    def run(self, subject: Subject) -> tuple[dict[str, Any], list[judge.Slope], Processes]:
        """Play it; returns figures, fits and samples. The daemon is ended."""
        name, endpoint, page = subject.rig, subject.endpoint, subject.page
        processes, lateness = Processes(subject.pids), Lateness(subject.runtime.records.reader())
        commander = Commander(endpoint, name, random.Random(self._seed + 1))
        visitors = Visitors(endpoint, name, random.Random(self._seed + 2))
        listener, reader, onlooker = Listener(endpoint, name), PageReader(page), Onlooker(page)
        load = (commander, visitors, listener, reader, onlooker)
        for worker in load:
            worker.start()
        pauses, start = Pauses(lambda: _timely(subject.pids())), time.monotonic()
        recorded = self._play(subject, processes, lateness, load)
        for worker in load:
            worker.end()
        pauses.end()
        self._take_events(endpoint, name)
        code = subject.end()
        whole = self._recording(subject.recordings)
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
                "records_lost_by_a_listener": judge.lost(listener.lost, self._overwritten, pauses.seen),
                "records_missed_in_the_ring": lateness.gaps,
                "records_missing_in_the_recording": whole["missing"],
            },
            "recording_read_s": whole["read_s"],
            "overwritten": self._overwritten,
            "trips": judge.explained(trips, control_ns, pauses.seen),
            "pauses": {"count": len(pauses.seen), "longest_ms": max((one.ms for one in pauses.seen), default=0.0)},
            "browser": {
                "there": onlooker.there,
                "open_s": round(onlooker.open_s, 1),
                "draws": onlooker.draws,
                "errors": sorted(onlooker.errors),
            },
            "lateness": lateness.figures(),
            "disk_filled": subject.disk is not None,
            "workers": {worker.name: worker.error for worker in load if worker.error},
        }
        busy = plan.busy(self._duration_s)
        slopes = [fit for life in processes.lives if (fit := judge.slope(life, busy)) is not None]
        results["processes"] = [asdict(fit) for fit in slopes]
        results["samples"] = [
            {"name": one.name, "pid": one.pid, "s_mib_handles": one.table.round(2).tolist()} for one in processes.lives
        ]
        results["broken"] = judge.broken(results, slopes)
        return results, slopes, processes

    def _play(
        self, subject: Subject, processes: Processes, lateness: Lateness, load: tuple[Worker, ...]
    ) -> Counter[str]:
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
                self._strike(due.pop(0), subject, now)
            if now - sampled >= every:
                sampled = now
                processes.sample(now)
                written = subject.runtime.known(RECORDED)
                told = written.get("recording") or {}
                losses[int(written.get("pid", 0))] = (told.get("records_lost", 0), told.get("frames_lost", 0))
            if busy and now - said >= min(60.0, self._duration_s / 6):
                said = now
                self._take_events(subject.endpoint, subject.rig)
                self._say(f"{now:.0f} s: {lateness.records} records, {len(self._struck)} strikes")
            lateness.follow("busy" if busy else "alone")
            time.sleep(POLL_S)
        until = time.monotonic() + BACK_S
        while (gone := {*plan.VICTIMS} - subject.pids().keys()) and time.monotonic() < until:
            time.sleep(POLL_S)
        self._not_back += sorted(gone)
        return Counter(
            records=sum(records for records, _ in losses.values()), frames=sum(frames for _, frames in losses.values())
        )

    def _strike(self, strike: plan.Strike, subject: Subject, now: float) -> None:
        self._struck.append({"what": strike.what, "at_s": round(now, 1), "t_ns": time.monotonic_ns()})
        if strike.what == "disk":
            if subject.disk is not None:
                with filled(subject.disk):
                    time.sleep(plan.DISK_FULL_S)
            return
        pid = subject.pids().get(strike.what)
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
            self._overwritten = int(client.state().get("samples_lost", 0))

    def _recording(self, folder: pathlib.Path) -> dict[str, float]:
        """Records missing in the recording as it was kept, and the time it covers."""
        files = sorted(folder.glob("*.mcap"))
        if not files:
            return {"missing": 1, "read_s": 0.0}
        found = recording.read(*parts.of_same_run(files[-1]), frames=False)
        seq = found.records["seq"].astype(int)
        missing = int(seq[-1] - seq[0] + 1 - len(seq))
        return {"missing": missing, "read_s": round((found.end_ns - found.start_ns) * 1e-9, 1)}
