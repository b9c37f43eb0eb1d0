"""``telemetry.join``: endpoints of other routers, and nothing else."""

from __future__ import annotations

import pathlib

from rigctl.config import rig_file as config
from tests.builders.daemons import rig_file


def test_a_gateway_joins_only_the_routers_of_its_setting(tmp_path: pathlib.Path) -> None:
    assert config.load(rig_file(tmp_path)).telemetry.join == []
    others = ["tcp/192.168.1.10:7447", "tcp/127.0.0.1:7448"]
    waived = {"join": others, "listen_waiver": "the other router is on a network of the rigs alone"}
    assert config.load(rig_file(tmp_path, {"telemetry": waived})).telemetry.join == others
