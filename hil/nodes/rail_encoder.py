"""Absolute rotary encoder on the rail's shaft, CiA 406."""

from __future__ import annotations

import math

from hil.nodes.dictionary import number
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.devices import objects

SERIAL = 406001


class RailEncoder(Node):
    """Samples the rail's angle at every SYNC (0x6004, in counts, from 0 up to 0x6002)."""

    def __init__(self, network: RigNetwork, settings: RigSettings, plant: Plant) -> None:
        rail = settings.rail_encoder
        assert rail is not None  # there is no node without it
        super().__init__(network, rail.node, settings.file(rail.eds), plant, SERIAL)
        self._counts_per_turn = self._total_range = self._position = 0
        self.readers[objects.ENCODER_POSITION, 0] = lambda: self._position
        self.writers[objects.ENCODER_COUNTS_PER_TURN, 0] = self._set_counts_per_turn
        self.writers[objects.ENCODER_TOTAL_RANGE, 0] = self._set_total_range

    def on_node_reset(self) -> None:
        """Take the default scale."""
        self._counts_per_turn = number(self.device, objects.ENCODER_COUNTS_PER_TURN)
        self._total_range = number(self.device, objects.ENCODER_TOTAL_RANGE)

    def on_sample(self) -> None:
        """Count the rail's angle."""
        turns = self.plant.truth.rail_rad / math.tau
        self._position = math.floor(turns * self._counts_per_turn) % self._total_range

    def _set_counts_per_turn(self, value: int) -> None:
        self._counts_per_turn = value

    def _set_total_range(self, value: int) -> None:
        self._total_range = value
