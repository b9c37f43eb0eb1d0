"""``rigctl bridge foxglove``: a rig's client on one side, a server of the Foxglove protocol on the other."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl.bridge import json_channels as texts
from rigctl.bridge import record_channel
from rigctl.bridge.foxglove_protocol import Channel
from rigctl.bridge.foxglove_server import FoxgloveServer
from rigctl.bridge.processor import keep_off
from rigctl.bridge.record_channel import RecordEncoding, thinned
from rigctl.bridge.rig_parameters import parameters_of
from rigctl.client import AsyncRig, NoDaemonError, Rig, SchemaError
from rigctl.client.shapes import Message
from rigctl.config.address import Address, is_local
from rigctl.ipc.async_termination import run_until_signal

FIGURES_S = 1.0
AGAIN_S = 0.5


class FoxgloveBridge:
    """What one rig says, on the channels of a server."""

    def __init__(
        self, rig: AsyncRig, server: FoxgloveServer, schema: Message, active: Mapping[str, Any], rate_hz: float
    ) -> None:
        """``schema``, ``active``: schema and configuration of the daemon; ``rate_hz``: of the records."""
        self._rig, self._server, self._rate_hz = rig, server, rate_hz
        self._configure(active)
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        self._samples = rig.fast()
        self._types = {name: np.dtype(field.type).str for name, field in rig.fields.items()}
        self._encoding = RecordEncoding(self._types)
        self._records = self._offer_records()
        self._state = self._json(texts.STATE, "rigctl.State", texts.state_schema(schema))
        self._events = self._json(texts.EVENTS, "rigctl.Event", texts.event_schema(schema))
        self._log = self._json(texts.LOG, "foxglove.Log", texts.LOG_SCHEMA)
        self._figures = self._json(texts.BRIDGE, "rigctl.Bridge", texts.BRIDGE_SCHEMA)

    def _json(self, topic: str, name: str, schema: str) -> Channel:
        return self._server.offer(topic, "json", name, schema, "jsonschema")

    def _offer_records(self) -> Channel:
        encoding = self._encoding
        return self._server.offer(record_channel.TOPIC, "protobuf", encoding.name, encoding.schema, "protobuf")

    async def run(self) -> None:
        """Publish until cancelled.

        Raises:
            SchemaError: the daemon was replaced by one whose schema this client does not know.
        """
        async with asyncio.TaskGroup() as tasks:
            for task in (self._follow_configs, self._follow_states, self._follow_events, self._follow_records,
                         self._publish_figures):  # fmt: skip
                tasks.create_task(task())

    async def _follow_configs(self) -> None:
        async with self._rig.configs() as configs:  # subscribed before it is asked for: no change is missed
            while True:
                with contextlib.suppress(NoDaemonError):
                    self._configure(await self._rig.config())
                    break
                await asyncio.sleep(AGAIN_S)
            async for active in configs:
                self._configure(active)

    def _configure(self, active: Mapping[str, Any]) -> None:
        self._server.set_parameters(parameters_of(active))
        loop = (active.get("settings") or {}).get("loop") or {}
        self._loop_hz = float(loop.get("rate_hz") or self._rate_hz)
        if is_local(self._rig.rig.connection.endpoint):
            keep_off(loop.get("cpu"))

    async def _follow_states(self) -> None:
        async with self._rig.states() as states:
            async for state in states:
                if state.get("t_ns") is None:
                    continue
                self._wall_offset_ns = int(state["wall_ns"]) - int(state["t_ns"])
                self._publish_json(self._state, int(state["wall_ns"]), state)

    async def _follow_events(self) -> None:
        async with self._rig.events() as events:
            async for event in events:
                self._publish_json(self._events, int(event["wall_ns"]), event)
                self._server.publish(self._log, [int(event["wall_ns"])], [texts.log_line(event)])

    async def _follow_records(self) -> None:
        async with self._samples as samples:
            async for block in samples:
                self._publish_records(block)

    def _publish_records(self, block: npt.NDArray[Any]) -> None:
        types = {name: block.dtype[name].str for name in block.dtype.names or ()}
        if types != self._types:  # a daemon of another version has taken the other's place
            self._types = types
            self._server.withdraw(self._records)
            self._encoding = RecordEncoding(types)
            self._records = self._offer_records()
        if not self._server.is_wanted(self._records):
            return
        chosen = thinned(block, self._rate_hz, self._loop_hz)
        walls = (chosen["t_ns"] + self._wall_offset_ns).tolist()
        self._server.publish(self._records, walls, self._encoding.encode(chosen))

    async def _publish_figures(self) -> None:
        while True:
            count = self._samples.count
            self._publish_json(self._figures, time.time_ns(), {
                "clients": self._server.clients, "dropped_clients": self._server.dropped,
                "received": count.received, "lost": count.lost, "refused": self._rig.refused,
            })  # fmt: skip
            await asyncio.sleep(FIGURES_S)

    def _publish_json(self, channel: Channel, wall_ns: int, message: Mapping[str, Any]) -> None:
        if self._server.is_wanted(channel):
            self._server.publish(channel, [wall_ns], [msgspec.json.encode(message)])


async def _serve(rig: Rig, listening: socket.socket, address: Address, origins: Sequence[str], rate_hz: float) -> None:
    server = FoxgloveServer(rig.name, address, origins, _complain)
    # Before any client is served: a record is thinned by the loop's rate, and parameters are read once.
    schema, active = await _answer(rig.schema), await _answer(rig.config)
    async with server.serving(listening):
        await FoxgloveBridge(AsyncRig(rig), server, schema, active, rate_hz).run()


async def _answer(query: Callable[[], Message]) -> Message:
    """The daemon's answer, as soon as there is one: a busy computer may take longer than a query waits."""
    while True:
        with contextlib.suppress(NoDaemonError):
            return await asyncio.to_thread(query)
        await asyncio.sleep(AGAIN_S)


def _complain(text: str) -> None:
    sys.stderr.write(f"bridge: {text}\n")
    sys.stderr.flush()


def serve(rig: Rig, listening: socket.socket, address: Address, origins: Sequence[str], rate_hz: float) -> str | None:
    """Serve until a signal of ``ENDING``; returns why it could not go on, None after a signal.

    Args:
        rig: a client of the daemon.
        listening: the socket of ``address``.
        address: where it listens.
        origins: of web pages that may connect beside those of this computer.
        rate_hz: of the records; the loop's own rate is the most.
    """
    try:
        run_until_signal(_serve(rig, listening, address, origins, rate_hz), asyncio.Task.cancel)
    except asyncio.CancelledError:
        return None
    except SchemaError as error:
        return str(error)
    except BaseExceptionGroup as group:
        if group.subgroup(SchemaError) is None:
            raise
        return str(group.exceptions[0])
    return None
