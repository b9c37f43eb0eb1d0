"""Generic I/O node, CiA 401: digital inputs, sent when one changes and by the event timer, and digital outputs."""

from __future__ import annotations

from collections.abc import Callable

from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.dictionary import number
from hil.nodes.heartbeat_consumer import HeartbeatConsumer
from hil.nodes.network import RigNetwork
from hil.nodes.node import COMMUNICATION_ERROR, Node
from hil.nodes.pdo import ReceivePdo
from hil.plant import Plant
from rigctl.config.io_section import INPUTS_PER_BLOCK
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from rigctl.devices.objects import EmcyCode
from rigctl.model.device_states import NmtState

SERIAL = 401001
_INHIBIT_TIME, _EVENT_TIMER = 3, 5  # sub-indices of 0x1800
_NS_PER_INHIBIT_UNIT, _NS_PER_EVENT_UNIT = 100_000, 1_000_000
_LONG_AGO_NS = -(1 << 62)


class IoNode(Node):
    """One input is wired to the emergency stop: closed (1) until it is pressed. ``advance`` runs on the rig's grid.

    Where the rig file has ``drive_enable_output``, that output is wired to the drive's input for safe torque off, and
    the drive's feedback (1 without torque) to ``drive_off_input``. The outputs take their error values (0x6206, 0x6207)
    while the node is STOPPED or has lost the heartbeat that it consumes (0x1016), and are 0 without power.

    TPDO 1 is sent on entering OPERATIONAL, when an input changes whose event is not masked (0x6005, 0x6006) and when
    the event timer has expired, but not within the inhibit time.
    """

    def __init__(self, network: RigNetwork, settings: RigSettings, plant: Plant, drive: CylinderDrive) -> None:
        io = settings.io
        assert io is not None  # there is no node without it
        super().__init__(network, io.node, settings.file(io.eds), plant, SERIAL)
        self._closed = 1 << io.e_stop_input
        self._output, self._feedback = io.drive_enable_output, io.drive_off_input
        self._drive = drive
        self._written = 0  # outputs as the controller wants them
        self.enables = False  # the relay of the drive's enable is closed
        self.welded = False
        """Defect: that relay does not open."""
        self.without_power = False
        self._heartbeat = HeartbeatConsumer(network)
        self._rpdo: ReceivePdo | None = None
        if self._output is not None:
            drive.enable_by_wire(False)
        self.readers[objects.OUTPUTS_8, 1] = lambda: self._written
        self.writers[objects.OUTPUTS_8, 1] = self._write
        self.writers[objects.CONSUMER_HEARTBEAT, 1] = self._heartbeat.watch
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

    def switch_off(self, off: bool = True) -> None:
        """Take the node's own power away: it neither sends nor receives, and its relays open. Or give it back."""
        self.without_power = off
        if off:
            self._switch()
        else:
            self.reset_node()

    def supervise(self, t_ns: int, elapsed_ns: int) -> None:
        """Send the heartbeat and watch the controller's."""
        if self.without_power:
            return
        super().supervise(t_ns, elapsed_ns)
        if self._heartbeat.runs_out(self.clock.span_ns(elapsed_ns)):
            self.raise_error(EmcyCode.HEARTBEAT_LOST, COMMUNICATION_ERROR)
            if self.nmt_state is NmtState.OPERATIONAL and not number(self.device, objects.ERROR_BEHAVIOUR, 1):
                self._enter(NmtState.PRE_OPERATIONAL)
        elif not self._heartbeat.overdue:
            self.clear_error(EmcyCode.HEARTBEAT_LOST)
        self._switch()

    def _write(self, outputs: int) -> None:
        self._written = outputs
        self._switch()

    def _switch(self) -> None:
        """Switch the relay as the outputs are now, and with it the drive's torque."""
        outputs = self._written
        if self._heartbeat.overdue or self.nmt_state is NmtState.STOPPED:
            mode = number(self.device, objects.OUTPUT_ERROR_MODE_8, 1)
            outputs = outputs & ~mode | number(self.device, objects.OUTPUT_ERROR_VALUE_8, 1) & mode
        if self._output is None:
            return
        closed = not self.without_power and bool(outputs >> self._output & 1)
        if (on := closed or (self.welded and self.enables)) is not self.enables:
            self.enables = on
            self._drive.enable_by_wire(on)

    def _on_rpdo(self, _: int, data: bytes, __: float) -> None:
        rpdo = self._rpdo
        if self.nmt_state is NmtState.OPERATIONAL and rpdo is not None and len(data) >= rpdo.size:
            rpdo.apply(data)

    def on_node_reset(self) -> None:
        """Outputs at 0."""
        self._write(0)

    def on_communication_reset(self) -> None:
        """The heartbeat consumer at its default: off."""
        self._heartbeat.watch(number(self.device, objects.CONSUMER_HEARTBEAT, 1))

    def advance(self, t_ns: int) -> None:
        """Send the inputs if they have changed or the event timer has expired."""
        if self.nmt_state is not NmtState.OPERATIONAL or self.without_power:
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
        """Apply the timers, compile the RPDO anew and listen to its identifier."""
        super().on_pdo_change()
        if self._rpdo is not None and self._rpdo.valid:
            self.network.unsubscribe(self._rpdo.cob_id, self._on_rpdo)
        self._rpdo = ReceivePdo(self.device, self.writers)
        if self._rpdo.valid:
            self.network.subscribe(self._rpdo.cob_id, self._on_rpdo)
        communication = objects.TPDO1_COMMUNICATION
        self._inhibit_ns = number(self.device, communication, _INHIBIT_TIME) * _NS_PER_INHIBIT_UNIT
        self._event_ns = number(self.device, communication, _EVENT_TIMER) * _NS_PER_EVENT_UNIT

    def _reader(self, block: int) -> Callable[[], int]:
        shift = (block - 1) * INPUTS_PER_BLOCK

        def read() -> int:
            closed = 0 if self.e_stop_pressed else self._closed
            if self._feedback is not None and not self.enables:
                closed |= 1 << self._feedback
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
