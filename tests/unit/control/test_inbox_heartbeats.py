"""Heartbeats in the inbox: when each device was last heard."""

from __future__ import annotations

from rigctl.config import rig_file as config
from rigctl.devices import objects as od
from tests.unit.control.test_plain_inbox import CONFIG, Bench

RIG = config.load(CONFIG / "paper_rig.yaml")
MS = 1_000_000


def test_a_device_is_silent_from_the_first_tick_or_its_last_heartbeat_on() -> None:
    bench, cell, nodes = Bench(RIG), RIG.tension_cell.node, RIG.canopen_nodes.values()
    bench.give(0x7FF, b"")
    assert bench.inbox.heartbeats_t_ns == dict.fromkeys(nodes, 1 * MS)  # start-up has just reached all
    for _ in range(3):
        bench.give(od.HEARTBEAT_BASE + cell, bytes([od.NmtState.OPERATIONAL]))
    bench.give(0x7FF, b"")
    assert bench.inbox.heartbeats_t_ns == {node: 4 * MS if node == cell else 1 * MS for node in nodes}
