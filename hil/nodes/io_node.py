"""Generic I/O node, CiA 401: digital inputs, sent when one changes and by the event timer."""

from __future__ import annotations

from collections.abc import Callable

from hil.nodes.dictionary import number
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config.io_section import INPUTS_PER_BLOCK
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from rigctl.devices.objects import NmtState

SERIAL = 401001
_INHIBIT_TIME, _EVENT_TIMER = 3, 5  # sub-indices of 0x1800
_NS_PER_INHIBIT_UNIT, _NS_PER_EVENT_UNIT = 100_000, 1_000_000
_LONG_AGO_NS = -(1 << 62)


class IoNode(Node):
    """One input is wired to the emergency stop: closed (1) until it is pressed. ``advance`` runs on the rig's grid.

    TPDO 1 is sent on entering OPERATIONAL, when an input changes whose event is not masked (0x6005, 0x6006) and when
    the event timer has expired, but not within the inhibit time.
    """

    def __init__(self, network: RigNetwork, settings: RigSettings, plant: Plant) -> None:
        io = settings.io
        assert io is not None  # there is no node without it
        super().__init__(network, io.node, settings.file(io.eds), plant, SERIAL)
        self._closed = 1 << io.e_stop_input
        self.e_stop_pressed = False
        self._blocks = range(1, number(self.device, objects.INPUTS_8) + 1)
        self._inhibit_ns = self._event_ns = 0
        self._sent_ns = _LONG_AGO_NS
        self._last_sent: list[int] = []  # inputs as they were last sent
        for block in self._blocks:
            self.readers[objects.INPUTS_8, block] = self._reader(block)

    def press_e_stop(self, pressed: bool) -> None:
        """Open this node's contact, or close it again."""
        self.e_stop_pressed = pressed

    def advance(self, t_ns: int) -> None:
        """Send the inputs if they have changed or the event timer has expired."""
        if self.nmt_state is not NmtState.OPERATIONAL:
            return
        (tpdo,) = self.tpdos
        since_ns = t_ns - self._sent_ns
        if not tpdo.event_driven or since_ns < self._inhibit_ns:
            return
        inputs = [self.readers[objects.INPUTS_8, block]() for block in self._blocks]
        if (self._event_ns and since_ns >= self._event_ns) or self._is_event(inputs):
            self._last_sent, self._sent_ns = inputs, t_ns
            self.network.send_frame(tpdo.now())

    def on_state(self, before: NmtState, now: NmtState) -> None:
        """Entering OPERATIONAL sends all inputs."""
        super().on_state(before, now)
        self._last_sent = []

    def on_pdo_change(self) -> None:
        """Apply the timers."""
        super().on_pdo_change()
        communication = objects.TPDO1_COMMUNICATION
        self._inhibit_ns = number(self.device, communication, _INHIBIT_TIME) * _NS_PER_INHIBIT_UNIT
        self._event_ns = number(self.device, communication, _EVENT_TIMER) * _NS_PER_EVENT_UNIT

    def _reader(self, block: int) -> Callable[[], int]:
        shift = (block - 1) * INPUTS_PER_BLOCK

        def read() -> int:
            closed = 0 if self.e_stop_pressed else self._closed
            polarity = number(self.device, objects.INPUT_POLARITY_8, block)
            return (closed >> shift & objects.EVERY_INPUT_8) ^ polarity

        return read

    def _is_event(self, inputs: list[int]) -> bool:
        """Whether an input has changed whose event is not masked; the first inputs always are an event."""
        if inputs == self._last_sent or (self._last_sent and not number(self.device, objects.INPUT_EVENTS)):
            return False
        return not self._last_sent or any(
            (now ^ before) & number(self.device, objects.INPUT_EVENT_MASK_8, block)
            for block, now, before in zip(self._blocks, inputs, self._last_sent, strict=True)
        )
