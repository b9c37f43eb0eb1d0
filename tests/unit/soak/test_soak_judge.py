"""The soak's judgement: a leak is found in noise, noise is no leak, and every trip needs its cause."""

from __future__ import annotations

import dataclasses
import itertools
import os
import random
import signal
import time

import numpy as np
import pytest

from tests.builders.miniature import stop
from tests.soak import plan
from tests.soak.judge import explained, lost, slope
from tests.soak.pauses import LATE_MS, Pause, Pauses
from tests.soak.sampling import Life
from tests.soak.subject import SubjectError, installed

HOUR = np.arange(0.0, 3600.0, 2.0)


def life(memory_mib: np.ndarray, handles: np.ndarray | float = 20.0) -> Life:
    handles = np.broadcast_to(handles, HOUR.shape)
    samples = [(t, m, int(h)) for t, m, h in zip(HOUR, memory_mib, handles, strict=True)]
    return Life("gateway", 7, samples)


def noisy(level: float, seed: int = 1) -> np.ndarray:
    found: np.ndarray = level + np.random.default_rng(seed).normal(0.0, 0.5, len(HOUR))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_single_peaks_are_flat(seed: int) -> None:
    memory = noisy(60.0, seed)
    memory[:20] = np.linspace(20.0, 60.0, 20)  # imports
    memory[500:520] += 40.0  # a flood of clients
    fit = slope(life(memory))
    assert fit is not None
    assert list(fit.findings) == []


@pytest.mark.parametrize("leak_mib_h", [3.0, 5.0])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_slow_leak_is_found_in_noise(leak_mib_h: float, noise: float) -> None:
    fit = slope(life(60.0 + noise * noisy(0.0) + HOUR / 3600.0 * leak_mib_h))
    assert fit is not None
    (line,) = fit.findings
    assert line.startswith("gateway (process 7): memory grew by ")


def test_a_file_handle_a_few_minutes_is_found() -> None:
    fit = slope(life(noisy(60.0), 20 + np.floor(HOUR / 600.0)))
    assert fit is not None
    assert [line for line in fit.findings if "file handles grew" in line]


def test_what_the_load_itself_takes_is_no_growth() -> None:
    memory = np.where(HOUR < 360.0, 60.0, 66.0)  # with clients, from the load's beginning on
    fit = slope(life(memory), (360.0, 3240.0))
    assert fit is not None
    assert list(fit.findings) == []
    assert fit.minutes == pytest.approx(47.0, abs=0.1)


def test_a_short_life_is_not_judged() -> None:
    assert slope(Life("page", 1, [(float(t), 10.0 + t, 5) for t in range(100)])) is None


def test_a_trip_needs_a_cause_in_the_log_and_a_reason_in_the_soak() -> None:
    second = 10**9
    killed = {"t_ns": 10 * second, "text": "trip OVERRUN: late"}
    silent = {"t_ns": 200 * second, "text": "trip BUS_SILENT: no frame"}
    assert [one["cause"] for one in explained([killed, silent], [5 * second], [])] == [
        "control was killed 5.0 s before",
        "",
    ]
    pause = Pause(200 * second - second // 10, 120.0, "processor 1 paused")
    assert explained([silent], [], [pause])[0]["cause"] == "processor 1 paused for 120 ms"
    assert explained([silent], [], [Pause(190 * second, 500.0, "processor 1 paused")])[0]["cause"] == ""
    assert explained([{"t_ns": second, "text": "", "seq": 4}], [0], []) == [
        {"text": "event 4 without a text", "cause": ""}
    ]


def test_a_loss_is_excused_where_the_gateway_got_no_processor() -> None:
    waited = [Pause(second * 10**9, 600.0, "the gateway waited for a processor") for second in range(10)]
    assert lost(9000, 9000, waited) == 0
    assert lost(9000, 8000, waited) == 1000
    assert lost(9000, 9000, waited[:3]) == 9000
    apart = [dataclasses.replace(one, t_ns=one.t_ns * 10) for one in waited]
    assert lost(9000, 9000, apart) == 9000  # short waits of many restarts lose nothing


def test_a_pause_of_a_processor_is_seen() -> None:
    pauses = Pauses(dict)
    for sleeper in pauses.sleepers:
        stop(sleeper)
    time.sleep(3 * LATE_MS / 1000.0)  # the pause itself
    for sleeper in pauses.sleepers:
        sleeper.send_signal(signal.SIGCONT)
    pauses.end()
    assert {one.what for one in pauses.seen} == {f"processor {cpu} paused" for cpu in os.sched_getaffinity(0)}
    assert all(one.ms >= LATE_MS for one in pauses.seen)


def test_a_seed_gives_one_plan_and_every_process_is_struck() -> None:
    long = plan.strikes(3600.0, random.Random(5))
    assert long == plan.strikes(3600.0, random.Random(5))
    assert {strike.what for strike in long} == {*plan.VICTIMS, "disk"}
    assert {strike.what for strike in plan.strikes(600.0, random.Random(5))} == {*plan.VICTIMS, "disk"}
    begin, end = plan.busy(3600.0)
    assert all(begin < strike.at_s < end for strike in long)
    assert all(b.at_s - a.at_s >= plan.SHORTEST_S for a, b in itertools.pairwise(long))


@pytest.mark.parametrize(("text", "expected"), [("120s", 120.0), ("10m", 600.0), ("8h", 28800.0), ("1.5h", 5400.0)])
def test_a_time_is_read_with_its_unit(text: str, expected: float) -> None:
    assert plan.seconds(text) == expected


@pytest.mark.parametrize("text", ["", "5s", "-1h", "1d", "h"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a time of 30 s or more"):
        plan.seconds(text)


def test_a_rig_that_is_not_installed_is_refused_in_one_line() -> None:
    with (
        pytest.raises(SubjectError, match=r"found no /etc/rigctl/nosuch\.yaml, expected an installed rig"),
        installed("nosuch"),
    ):
        pass
