"""Heartbeats in the inbox: when each device was last heard."""

from __future__ import annotations

import math

import pytest

from rigctl.config import rig_file as config
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.devices import objects as od
from rigctl.model.device_states import NmtState
from rigctl.model.samples import Quality
from tests.unit.control.test_plain_inbox import CONFIG, Bench

RIG = config.load(CONFIG / "paper_rig.yaml")
MS = 1_000_000


def test_a_device_is_silent_from_the_first_tick_or_its_last_heartbeat_on() -> None:
    bench, cell, nodes = Bench(RIG), RIG.tension_cell.node, RIG.canopen_nodes.values()
    bench.give(0x7FF, b"")
    assert bench.inbox.network.heartbeats_t_ns == dict.fromkeys(nodes, 1 * MS)  # start-up has just reached all
    for _ in range(3):
        bench.give(od.HEARTBEAT_BASE + cell, bytes([NmtState.OPERATIONAL]))
    bench.give(0x7FF, b"")
    assert bench.inbox.network.heartbeats_t_ns == {node: 4 * MS if node == cell else 1 * MS for node in nodes}


def test_a_change_of_state_is_told_once_by_itself() -> None:
    bench, cell = Bench(RIG), RIG.tension_cell.node
    for state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
        bench.give(od.HEARTBEAT_BASE + cell, bytes([state]))
        bench.inbox.network.notices()
    bench.give(od.HEARTBEAT_BASE + cell, bytes([NmtState.STOPPED]))
    notices = bench.inbox.network.notices()
    assert notices is not None
    assert notices.node_states
    assert not (notices.emergencies or notices.bus_errors or notices.foreign_sdo)
    bench.give(od.HEARTBEAT_BASE + cell, bytes([NmtState.STOPPED]))
    assert bench.inbox.network.notices() is None


def test_an_angle_of_the_rail_is_good_until_its_encoder_reports_an_error() -> None:
    rail = RailEncoderSettings(node=5, rate_hz=RIG.loop.rate_hz, counts_per_turn=4096)
    bench = Bench(RIG.model_copy(update={"rail_encoder": rail}))
    bench.give(od.TPDO1_BASE + rail.node, (1024).to_bytes(4, "little"))
    assert (bench.inbox.rail.quality, bench.inbox.rail_fresh) == (0, True)
    assert bench.inbox.rail.rad == pytest.approx(math.pi / 2.0)
    bench.give(od.EMCY_BASE + rail.node, bytes([0x00, 0x50, 0x01, 0, 0, 0, 0, 0]))
    bench.give(od.TPDO1_BASE + rail.node, (2048).to_bytes(4, "little"))
    assert (bench.inbox.rail.quality, bench.inbox.rail_fresh) == (Quality.INVALID, False)
    assert bench.inbox.rail.rad == pytest.approx(math.pi / 2.0)
