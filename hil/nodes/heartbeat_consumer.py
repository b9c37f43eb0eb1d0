"""Heartbeat consumer, CiA 301 0x1016: a device's watch over one other node."""

from __future__ import annotations

from hil.nodes.deadline import Deadline
from hil.nodes.network import RigNetwork
from rigctl.devices import objects
from rigctl.model.device_states import NmtState


class HeartbeatConsumer(Deadline):
    """Expires when the node of an entry of 0x1016 has been silent for its time; its first heartbeat arms it."""

    __slots__ = ("_cob", "_network")

    def __init__(self, network: RigNetwork) -> None:
        super().__init__()
        self._network, self._cob = network, 0

    def watch(self, entry: int) -> None:
        """Node id in bits 16 to 22, time in ms below; a 0 in either turns supervision off."""
        if self._cob:
            self._network.unsubscribe(self._cob, self._on_heartbeat)
        node, limit_ms = entry >> 16 & 0x7F, entry & 0xFFFF
        self._cob = objects.HEARTBEAT_BASE + node if node and limit_ms else 0
        self.set_limit_ms(limit_ms if node else 0)
        if self._cob:
            self._network.subscribe(self._cob, self._on_heartbeat)

    def _on_heartbeat(self, _: int, data: bytes, __: float) -> None:
        if data and data[0] != NmtState.BOOT_UP:
            self.renew()
