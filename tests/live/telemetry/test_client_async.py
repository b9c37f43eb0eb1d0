"""The public client on an event loop: it never blocks, and no cancellation loses data."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import AsyncIterator

import numpy as np
import pytest

import rigctl.client
from rigctl.client import AsyncRig, connect_async
from tests.builders.miniature import Daemon, stop
from tests.builders.waiting import patience_s


@contextlib.asynccontextmanager
async def connected(daemon: Daemon) -> AsyncIterator[AsyncRig]:
    async with asyncio.timeout(patience_s() * 4), connect_async(daemon.endpoint, timeout_s=patience_s()) as rig:
        yield rig


async def ticking(ticks: list[int]) -> None:
    while True:
        ticks.append(len(ticks))
        await asyncio.sleep(0.01)


def test_samples_states_events_and_commands(own: Daemon) -> None:
    async def session() -> None:
        async with connected(own) as rig:
            assert (rig.name, rig.fields["stroke_mm"].unit) == ("paper_rig", "mm")
            assert await rig.wait_alive(patience_s())
            assert (await rig.schema())["rig"] == (await rig.config())["settings"]["rig"] == "paper_rig"
            async with rig.fast() as samples:
                block = await anext(samples)
                assert np.all(block["target_n"] == 300.0)
            async with rig.states() as states:
                assert (await anext(states))["tick"] >= block["tick"][-1]
            answer = await rig.command("arm", operator="kim")
            assert answer["accepted"]
            event = await rig.wait_event(kind="MODE", timeout_s=patience_s())
            assert event is not None
            assert event["text"] == "DISARMED -> HOLD: drive enabled"
            assert await rig.wait_event(kind="MODE", timeout_s=0.1) is None
            assert (await rig.return_lease("kim"))["accepted"]
            async with rig.events(past=True) as events:
                assert (await anext(events))["kind"] == "STARTED"

    asyncio.run(session())


def test_what_waits_for_the_daemon_does_not_block_the_event_loop(own: Daemon) -> None:
    own.rig().close()
    assert own.gateway is not None
    gateway = own.gateway

    async def session() -> None:
        async with connected(own) as rig:
            ticks: list[int] = []
            ticker = asyncio.ensure_future(ticking(ticks))
            stop(gateway)
            try:
                with pytest.raises(rigctl.client.NoDaemonError):
                    await rig.state()  # waits two seconds for the reply
                assert len(ticks) > 50
                assert await rig.wait_event(timeout_s=0.3) is None
                assert not [sample async for sample in _for(rig.fast(), 0.3)]
            finally:
                gateway.send_signal(signal.SIGCONT)
            assert len(ticks) > 65
            ticker.cancel()

    asyncio.run(session())


async def _for(samples: rigctl.client.AsyncSamples, seconds: float) -> AsyncIterator[object]:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            async for block in samples:
                yield block


def test_no_sample_is_lost_by_steps_that_are_cancelled(own: Daemon) -> None:
    """Cancelled while waiting, and while querying what a full mailbox dropped and a killed gateway did not publish."""
    numbers: list[int] = []

    async def session() -> rigctl.client.Count:
        async with connected(own) as rig, rig.fast(depth=8) as samples:
            cancelled = 0
            for round_ in range(3):
                time.sleep(0.5)  # a program that blocks its own event loop: eight blocks of these remain
                if round_ == 1:
                    own.kill_gateway()
                    own.start_gateway()
                until = len(numbers) + 800
                while len(numbers) < until:
                    try:
                        async with asyncio.timeout(0.002):
                            numbers.extend((await anext(samples))["seq"].tolist())
                    except TimeoutError:
                        cancelled += 1
            assert cancelled > 10
            return samples.count

    count = asyncio.run(session())
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert count.recovered > 300
    assert count.lost == 0


def test_a_flood_of_samples_leaves_other_tasks_their_turn(shared: Daemon) -> None:
    async def session() -> None:
        async with connected(shared) as rig, rig.fast() as samples:
            time.sleep(1.0)  # fifty blocks wait now
            ticks: list[int] = []

            async def spin() -> None:
                while True:
                    ticks.append(1)
                    await asyncio.sleep(0)

            spinner = asyncio.ensure_future(spin())
            for _ in range(40):
                await anext(samples)
            assert len(ticks) >= 40
            spinner.cancel()

    asyncio.run(session())


def test_connecting_that_is_given_up_leaves_no_session(shared: Daemon) -> None:
    async def session() -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2), connect_async("tcp/127.0.0.1:1", timeout_s=0.5):
                raise AssertionError("nobody is there")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0), connect_async(shared.endpoint, timeout_s=patience_s()):
                raise AssertionError("too early")

    shared.rig().close()
    asyncio.run(session())
