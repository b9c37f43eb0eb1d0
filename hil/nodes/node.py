"""The common part of the simulated devices: CiA 301 on canopen's ``LocalNode`` (its dictionary and SDO server)."""

from __future__ import annotations

import functools
import pathlib
import pickle
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import canopen

from hil.nodes.clock import DeviceClock
from hil.nodes.dictionary import STRUCT_CODES, Abort, check_range, number, refuse
from hil.nodes.network import RigNetwork
from hil.nodes.pdo import Address, TransmitPdo, check_cob_id_write, check_inhibit_write, check_mapping_write
from hil.plant import Plant
from hil.wire import STANDARD_MASK
from rigctl.config.simulation_section import DevicesSettings
from rigctl.devices import objects
from rigctl.model.device_states import NmtState

ERROR_FIELD = 0x1003
ERROR_FIELD_LENGTH = 8
GENERIC_ERROR = 0x01  # bits of the error register 0x1001
COMMUNICATION_ERROR = 0x10
_EMCY = struct.Struct("<HB5x")
_SDO_SIZE = 8
_SEGMENT_REQUESTS = frozenset({0x00, 0x60})  # client command specifiers that continue a transfer
_BLOCK_TRANSFERS = frozenset({0xA0, 0xC0})  # upload, download: optional in CiA 301, and these devices have none
_MULTIPLEXER = struct.Struct("<HB")
_SYNC_CONSUMED_ALWAYS = 1 << 31  # bit of 0x1005 without a meaning
_INHIBIT_TIME = 3  # sub-index
_COMMUNICATION_AREA = range(0x1000, 0x2000)
_TPDO_MAPPINGS = range(objects.TPDO1_MAPPING, objects.TPDO1_MAPPING + objects.PDOS)
_TPDO_COMMUNICATIONS = range(objects.TPDO1_COMMUNICATION, objects.TPDO1_COMMUNICATION + objects.PDOS)
_MAPPINGS = frozenset({objects.RPDO1_MAPPING, *_TPDO_MAPPINGS})
_COMMUNICATIONS = frozenset({objects.RPDO1_COMMUNICATION, *_TPDO_COMMUNICATIONS})


@functools.lru_cache(maxsize=64)
def _parsed(eds: pathlib.Path, node_id: int, _changed_ns: int) -> bytes:
    """An object dictionary, pickled: each device has its own, since it changes defaults, and parsing takes 5 ms."""
    return pickle.dumps(canopen.import_od(str(eds), node_id))


class _Device(canopen.LocalNode):  # type: ignore[misc]
    """canopen's node, which also reports when a value has been stored (canopen's write callbacks come before)."""

    def __init__(self, node_id: int, eds: pathlib.Path, on_stored: Callable[[int], None]) -> None:
        super().__init__(node_id, pickle.loads(_parsed(eds, node_id, eds.stat().st_mtime_ns)))
        self._on_stored = on_stored

    def _find_object(self, index: int, subindex: int) -> Any:
        found = super()._find_object(index, subindex)
        if subindex and isinstance(self.object_dictionary[index], canopen.objectdictionary.ODVariable):
            raise refuse(Abort.NO_SUBINDEX)
        return found

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        super().set_data(index, subindex, data, check_writable)
        self._on_stored(index)


class Node:
    """A device on the bus.

    The rig advances the plant before any frame or request is handed over. All times of a device are by its own
    ``clock``. A subclass registers its live objects in ``readers`` and ``writers`` and overrides the ``on_...``
    methods.

    Args:
        network: the wire.
        node_id: 1 to 127.
        eds: electronic data sheet.
        plant: what the device measures or drives.
        serial: serial number in the identity object.
        clock_ppm: gain of its clock on the rig's.
    """

    def __init__(
        self,
        network: RigNetwork,
        node_id: int,
        eds: pathlib.Path,
        plant: Plant,
        serial: int,
        clock_ppm: float = 0.0,
    ) -> None:
        self.id = node_id
        self.plant = plant
        self.clock = DeviceClock(plant.t_ns, clock_ppm)
        self.network = network
        self.nmt_state = NmtState.BOOT_UP
        self.device = _Device(node_id, eds, self._on_stored)
        self.readers: dict[Address, Callable[[], int]] = {
            (objects.ERROR_REGISTER, 0): self._error_register,
            (objects.IDENTITY, 4): lambda: serial,
            (ERROR_FIELD, 0): lambda: len(self._history),
            **{(ERROR_FIELD, i + 1): self._history_reader(i) for i in range(ERROR_FIELD_LENGTH)},
        }
        self.writers: dict[Address, Callable[[int], None]] = {
            (objects.PRODUCER_HEARTBEAT, 0): self._set_heartbeat,
            (objects.SYNC_COB_ID, 0): self.listen_to_sync,
            (ERROR_FIELD, 0): self._clear_history,
        }
        self._errors: dict[int, int] = {}
        self._history: deque[int] = deque(maxlen=ERROR_FIELD_LENGTH)
        self._heartbeat_ns = 0
        self._heartbeat_due_ns = 0
        self._sync_cob: int | None = None
        self._tpdos: list[TransmitPdo] = []  # empty: to be compiled anew
        self._tpdo_places = [i for i, index in enumerate(_TPDO_MAPPINGS) if index in self.device.object_dictionary]
        self._manner = DevicesSettings()
        self.refuses_start = False
        """Defect: NMT start has no effect."""
        self.claims_error = False
        """Defect: an emergency message has reported an error that the device does not have."""
        self._boots_ns: int | None = None  # end of the boot-up under way
        self._requests: deque[tuple[int, int, bytes, float]] = deque()  # SDO requests, each with its response time
        self._commands: dict[int, Callable[[], None]] = {
            0x01: self._to_operational,
            0x02: lambda: self._enter(NmtState.STOPPED),
            0x80: lambda: self._enter(NmtState.PRE_OPERATIONAL),
            0x81: self.reset_node,
            0x82: self.reset_communication,
        }
        network.add_node(self.device)
        network.unsubscribe(objects.NMT_COB, self.device.nmt.on_command)
        network.unsubscribe(self.device.sdo.rx_cobid, self.device.sdo.on_request)
        network.subscribe(objects.NMT_COB, self._on_nmt)
        network.subscribe(self.device.sdo.rx_cobid, self._on_sdo)
        self.device.sdo._index = self.device.sdo._subindex = 0
        self.device.add_read_callback(self._on_read)
        self.device.add_write_callback(self._on_write)

    def behave(self, manner: DevicesSettings) -> None:
        """Act as the variant of the device in ``manner``, from the next reset on."""
        self._manner = manner
        for index in _TPDO_COMMUNICATIONS if not manner.rtr else ():
            if index in self.device.object_dictionary:
                self.device.object_dictionary[index][1].default |= objects.PDO_NO_RTR

    @property
    def now_ns(self) -> int:
        """The time on the device's clock."""
        return self.clock.local_ns(self.plant.t_ns)

    # -- hooks for subclasses ----------------------------------------------------------------------------------

    def on_sample(self) -> None:
        """Take a new measurement of the plant, before values are read."""

    def on_state(self, before: NmtState, now: NmtState) -> None:
        """The NMT state has changed."""

    def on_node_reset(self) -> None:
        """Application objects are back at their defaults: apply them."""

    def on_communication_reset(self) -> None:
        """Communication objects are back at their defaults: apply them."""

    def on_pdo_change(self) -> None:
        """PDO parameters or mappings have changed."""
        self._tpdos.clear()

    # -- NMT ---------------------------------------------------------------------------------------------------

    def reset_node(self) -> None:
        """NMT reset node: every object back to its default, then reset communication."""
        self.device.data_store.clear()
        self._errors.clear()
        self.on_node_reset()
        if self._manner.boot_s:
            self._enter(NmtState.BOOT_UP)
            self._heartbeat_ns = 0
            self._requests.clear()
            self._boots_ns = self.now_ns + round(self._manner.boot_s * 1e9)
        else:
            self.reset_communication()

    def reset_communication(self) -> None:
        """NMT reset communication: the communication objects back to their defaults, then boot up."""
        for index in [i for i in self.device.data_store if i in _COMMUNICATION_AREA]:
            del self.device.data_store[index]
        self._enter(NmtState.BOOT_UP)
        self.listen_to_sync(number(self.device, objects.SYNC_COB_ID))
        self.on_communication_reset()
        self.on_pdo_change()
        self.network.send_message(objects.HEARTBEAT_BASE + self.id, bytes([NmtState.BOOT_UP]))
        self._set_heartbeat(number(self.device, objects.PRODUCER_HEARTBEAT))
        self._enter(NmtState.PRE_OPERATIONAL)

    def supervise(self, t_ns: int, elapsed_ns: int) -> None:  # noqa: ARG002 - for devices that watch others
        """Send the heartbeat when it is due; ``t_ns`` is on the device's clock.

        ``elapsed_ns``: time on the rig's clock that counts as silence since the last call.
        """
        if self._boots_ns is not None and t_ns >= self._boots_ns:
            self._boots_ns = None
            self.reset_communication()
        while self._requests and t_ns >= self._requests[0][0]:
            self._answer(*self._requests.popleft()[1:])
        if self._heartbeat_ns and t_ns >= self._heartbeat_due_ns:
            missed = (t_ns - self._heartbeat_due_ns) // self._heartbeat_ns
            self._heartbeat_due_ns += (missed + 1) * self._heartbeat_ns
            self.network.send_message(objects.HEARTBEAT_BASE + self.id, bytes([self.nmt_state]))

    def _on_nmt(self, _: int, data: bytes, __: float) -> None:
        if len(data) >= 2 and data[1] in (self.id, 0) and self._boots_ns is None:
            command = self._commands.get(data[0])
            if command is not None:
                command()

    def _to_operational(self) -> None:
        if not self.refuses_start:
            self._enter(NmtState.OPERATIONAL)

    def _enter(self, state: NmtState) -> None:
        before, self.nmt_state = self.nmt_state, state
        if before is not state:
            self._tpdos.clear()  # SYNCs are counted from the start
            self.on_state(before, state)

    def _set_heartbeat(self, period_ms: int) -> None:
        self._heartbeat_ns = period_ms * 1_000_000
        self._heartbeat_due_ns = self.now_ns + self._heartbeat_ns

    # -- SYNC and PDO ------------------------------------------------------------------------------------------

    @property
    def tpdos(self) -> list[TransmitPdo]:
        """The TPDOs as configured now."""
        if not self._tpdos:
            self._tpdos = [TransmitPdo(self.device, self.readers, place) for place in self._tpdo_places]
        return self._tpdos

    def listen_to_sync(self, entry: int | None) -> None:
        """0x1005: the identifier of the frames that are SYNC to this device from now on; None: no frame is."""
        if entry is not None and entry & ~_SYNC_CONSUMED_ALWAYS > STANDARD_MASK:
            raise refuse(Abort.VALUE_RANGE)  # these devices send no SYNC and take no extended one
        cob = None if entry is None else entry & STANDARD_MASK
        if cob == self._sync_cob:
            return  # keeps the place among the devices that one SYNC makes send
        if self._sync_cob is not None:
            self.network.unsubscribe(self._sync_cob, self._on_sync_frame)
        self._sync_cob = cob
        if cob is not None:
            self.network.subscribe(cob, self._on_sync_frame)

    @property
    def hears_sync(self) -> bool:
        """Whether any frame is SYNC to it."""
        return self._sync_cob is not None

    def _on_sync_frame(self, _: int, __: bytes, ___: float) -> None:
        self.on_sync()

    def on_sync(self) -> None:
        """Send the TPDOs that are due at this SYNC."""
        if self.nmt_state is not NmtState.OPERATIONAL or not self._tpdo_places:
            return
        self.on_sample()
        for tpdo in self._tpdos or self.tpdos:
            frame = tpdo.frame()
            if frame is not None:
                self.network.send_frame(frame)

    # -- SDO ---------------------------------------------------------------------------------------------------

    def _on_sdo(self, can_id: int, data: bytes, timestamp: float) -> None:
        if self.nmt_state is NmtState.STOPPED or self._boots_ns is not None or len(data) != _SDO_SIZE:
            return
        if self._manner.sdo_ms:
            self._requests.append((self.now_ns + self._manner.sdo_ms * 1_000_000, can_id, data, timestamp))
        else:
            self._answer(can_id, data, timestamp)

    def _answer(self, can_id: int, data: bytes, timestamp: float) -> None:
        server = self.device.sdo
        specifier = data[0] & 0xE0
        if specifier in _BLOCK_TRANSFERS or (specifier in _SEGMENT_REQUESTS and server._buffer is None):
            server._index, server._subindex = _MULTIPLEXER.unpack_from(data, 1)
            server.abort(Abort.COMMAND)  # not supported, or continues a transfer that was never begun
            return
        server.on_request(can_id, data, timestamp)

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:  # noqa: ARG002 - canopen's signature
        reader = self.readers.get((index, subindex))
        if reader is None:
            return None
        self.on_sample()
        return reader()

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        if od.data_type not in STRUCT_CODES:
            return
        value = int(od.decode_raw(data))
        check_range(od, value)
        if index in _MAPPINGS and self._manner.fixed_mapping:
            raise refuse(Abort.READ_ONLY)
        if index in _MAPPINGS:
            check_mapping_write(self.device, index, subindex, value)
        elif index in _COMMUNICATIONS and subindex == 1:
            check_cob_id_write(self.device, index, value, rtr=self._manner.rtr)
        elif index in _COMMUNICATIONS and subindex == _INHIBIT_TIME:
            check_inhibit_write(self.device, index)
        writer = self.writers.get((index, subindex))
        if writer is not None:
            writer(value)

    def _on_stored(self, index: int) -> None:
        if index in _MAPPINGS or index in _COMMUNICATIONS:
            self.on_pdo_change()

    # -- errors ------------------------------------------------------------------------------------------------

    def raise_error(self, code: int, register: int) -> None:
        """Report an error, once until it is cleared: emergency message, error register, history."""
        if code not in self._errors:
            self._errors[code] = register | GENERIC_ERROR
            self._history.appendleft(code)
            self._send_emergency(code)

    def clear_error(self, code: int) -> None:
        """An error is gone; the emergency message says "no error" when it was the last one."""
        if self._errors.pop(code, None) is not None:
            self._send_emergency(objects.EmcyCode.NO_ERROR)

    def distort(self, index: int, subindex: int, how: Callable[[int], int]) -> None:
        """A defect of the device: from now on an object reads as ``how`` of its value."""
        reader = self.readers[index, subindex]
        self.readers[index, subindex] = lambda: how(reader())
        self._tpdos.clear()

    def putting_back(self) -> Callable[[], None]:
        """What undoes, when called, every `distort`, another manner, and the loss of heartbeat or SYNC from now on.

        An error that an emergency message has claimed since then is withdrawn by another one.
        """
        readers, heartbeat_ns, sync_cob = dict(self.readers), self._heartbeat_ns, self._sync_cob
        manner, refuses_start = self._manner, self.refuses_start

        def undo() -> None:
            self._manner, self.refuses_start = manner, refuses_start
            self.readers.clear()
            self.readers.update(readers)
            self._tpdos.clear()
            if not self._heartbeat_ns:
                self._set_heartbeat(heartbeat_ns // 1_000_000)
            if self._sync_cob is None:
                self.listen_to_sync(sync_cob)
            if self.claims_error:
                self.claims_error = False
                self._send_emergency(objects.EmcyCode.NO_ERROR)

        return undo

    @property
    def errors(self) -> tuple[int, ...]:
        """Emergency codes of the errors present, oldest first."""
        return tuple(self._errors)

    def _send_emergency(self, code: int) -> None:
        if self.nmt_state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
            self.network.send_message(objects.EMCY_BASE + self.id, _EMCY.pack(code, self._error_register()))

    def _error_register(self) -> int:
        register = 0
        for bits in self._errors.values():
            register |= bits
        return register

    def _history_reader(self, place: int) -> Callable[[], int]:
        def read() -> int:
            if place >= len(self._history):
                raise refuse(Abort.NO_DATA)
            return self._history[place]

        return read

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise refuse(Abort.VALUE_RANGE)
        self._history.clear()
