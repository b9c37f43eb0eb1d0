"""``rigctl bridge prometheus``: a rig's client on one side, a page of metrics on the other."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from prometheus_client import CollectorRegistry

from rigctl.bridge.metrics_server import MetricsServer
from rigctl.bridge.processor import keep_off
from rigctl.bridge.prometheus_metrics import RigMetrics
from rigctl.client import NoDaemonError, Rig
from rigctl.client.shapes import Message
from rigctl.config.address import Address, is_local

TURN_S = 0.1
AGAIN_S = 0.5
SILENT_S = 1.0


def serve(rig: Rig, address: Address, told: Callable[[Address], None], stop: Callable[[], bool]) -> None:
    """Serve until ``stop()``.

    Args:
        rig: a client of the daemon.
        address: where to listen.
        told: called with the address once it listens.
        stop: whether to end.

    Raises:
        CannotListenError: the port is in use, may not be used, or the host is not this computer's.
        SchemaError: the daemon was replaced by one whose schema this client does not know.
    """
    schema, active = _answer(rig.schema, stop), _answer(rig.config, stop)
    if schema is None or active is None:
        return
    metrics, registry = RigMetrics(rig.name, schema["enums"]), CollectorRegistry()
    registry.register(metrics)
    if is_local(rig.connection.endpoint):
        keep_off(((active.get("settings") or {}).get("loop") or {}).get("cpu"))
    server = MetricsServer(address, registry)
    told(server.address)
    with rig.fast() as samples, rig.states() as states, rig.events() as events:
        state, heard_at = None, time.monotonic()
        while not stop():
            if (newest := states.newest()) is not None:
                state, heard_at = newest, time.monotonic()
            elif time.monotonic() - heard_at > SILENT_S:
                state = None
            count = samples.count
            metrics.take(state, list(samples.arrived()), list(events.arrived()), (count.received, count.lost))
            time.sleep(TURN_S)
    server.close()


def _answer(query: Callable[[], Message], stop: Callable[[], bool]) -> Message | None:
    """What the daemon answers, as soon as it does: a busy computer may take longer than a query waits."""
    while not stop():
        with contextlib.suppress(NoDaemonError):
            return query()
        time.sleep(AGAIN_S)
    return None
