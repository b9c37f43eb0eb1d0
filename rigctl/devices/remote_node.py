"""A CANopen device under configuration by SDO: every write is read back, and errors name device and object."""

from __future__ import annotations

import contextlib
import logging
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeVar

import canopen

from rigctl.config.settings import RigSettings
from rigctl.devices import eds_file
from rigctl.devices import objects as od
from rigctl.devices.eds_file import EdsError, EdsObject
from rigctl.devices.needed_objects import MOST_ENTRIES
from rigctl.devices.sdo import Watched
from rigctl.devices.startup_bus import StartupBus
from rigctl.model import emergency
from rigctl.model.device_states import NmtState
from rigctl.model.quantity import count

logging.getLogger("canopen").addHandler(logging.NullHandler())  # our errors say the same, with the device
TRIES = 3
"""Requests to a device that has answered before, until it counts as silent."""
_Value = TypeVar("_Value")
_MOST_SEGMENTS = 4  # no object read here needs more than one
_ASK_AGAIN_S = 0.05
_BOOT_S = 1.0  # in which a device has sent its boot-up message after "reset communication"
_GARBLED = (struct.error, canopen.ObjectDictionaryError)  # canopen raises these on short frames and wrong sizes


class StartupError(RuntimeError):
    """The rig differs from the rig file, or does not answer; ``str()`` is one line."""


class SilentError(StartupError):
    """A device does not answer."""


@dataclass(frozen=True)
class Device:
    """Identity of a device, CiA 301 0x1000 and 0x1018."""

    name: str
    node: int
    device_type: int
    vendor: int
    product: int
    revision: int
    serial: int


@dataclass(frozen=True)
class StopSetting:
    """One setting of the drive's own stop: value written, value read back, and ``why`` where that failed."""

    name: str
    object: str
    wanted: int
    found: int | None
    why: str = ""

    @property
    def ok(self) -> bool:
        """The drive has it."""
        return self.found == self.wanted


def repeated(transfer: Callable[[], _Value], tries: int = TRIES) -> _Value:
    """Result of a transfer, which is repeated where no answer comes: one lost frame is no silent device."""
    for _ in range(tries - 1):
        with contextlib.suppress(canopen.SdoCommunicationError):
            return transfer()
    return transfer()


class RemoteNode:
    """One device under configuration, with errors that name it."""

    def __init__(self, bus: StartupBus, settings: RigSettings, section: str, name: str) -> None:
        """``section``: the device's section in the rig file.

        Raises:
            StartupError: its EDS file cannot be used.
        """
        device = getattr(settings, section)
        self.name, self.id = name, int(device.node)
        self._section, self._device = section, device
        self._channel = f"{settings.can.interface}:{settings.can.channel}"
        self._bus = bus
        try:
            self._objects = eds_file.read(settings, section)
        except EdsError as error:
            raise StartupError(str(error)) from None
        self.remote = bus.add(self.id, device.sdo_timeout_ms * 1e-3, f"{name} (node {self.id})")
        self._verified: dict[tuple[int, int], Watched] = {}

    @property
    def verified(self) -> list[Watched]:
        """Every object read back with the right value, which the loop then keeps watching."""
        return list(self._verified.values())

    def where(self, index: int, sub: int) -> str:
        """Device and object, for an error."""
        return f"{self.name} (node {self.id}), object 0x{index:04X}:{sub:02X}"

    def has(self, index: int, sub: int = 0) -> bool:
        """Whether an object that is optional in its profile is in the device's EDS file."""
        return (index, sub) in self._objects

    def read(self, index: int, sub: int = 0, *, tries: int = TRIES) -> int:
        """Value of an object; a request without an answer is repeated."""
        with self._errors_named(index, sub, tries=tries):
            return repeated(lambda: self._upload(self._objects[index, sub]), tries)

    @contextlib.contextmanager
    def _errors_named(
        self, index: int, sub: int, refused: str = "cannot be read", tries: int = TRIES
    ) -> Iterator[None]:
        """A transfer of an object, whose errors name device and object; ``refused``: what an abort means.

        Raises:
            SilentError: the device does not answer.
            StartupError: any other error.
        """
        where = self.where(index, sub)
        try:
            yield
        except canopen.SdoAbortedError as error:
            raise StartupError(f"{where}: {refused}: {error}") from None
        except _GARBLED:
            raise StartupError(f"{where}: answered with what is no SDO answer on {self._channel}") from None
        except canopen.SdoCommunicationError:
            asked = f", asked {tries} times for {where.partition(', ')[2]}" if tries > 1 else ""
            raise SilentError(
                f"{self.name} (node {self.id}) does not answer on {self._channel} within {self._device.sdo_timeout_ms} "
                f"ms ({self._section}.sdo_timeout_ms){asked}: is the rig on and connected?"
            ) from None
        except KeyError:
            raise StartupError(f"{where}: not in its EDS file") from None

    def _upload(self, item: EdsObject) -> int:
        """An object's value; canopen's own upload has no bound on the segments a device sends.

        Raises:
            StartupError: the answer has not the object's length, and what is beyond it is more than padding.
        """
        data = b""
        with self.remote.sdo.open(item.index, item.sub, "rb", buffering=0) as stream:
            for _ in range(_MOST_SEGMENTS):
                if not (part := stream.read(7)):
                    break
                data += part
            else:
                raise canopen.ObjectDictionaryError("it does not end")
            if stream.exp_data is not None and stream.size is None:
                data = data[: item.size]  # expedited without a length: four bytes in any case
        signed = item.code.islower()
        value = int.from_bytes(data[: item.size], "little", signed=signed)
        if len(data) < item.size or int.from_bytes(data, "little", signed=signed) != value:
            raise StartupError(
                f"{self.where(item.index, item.sub)}: answered with {count(len(data), 'byte')} ({data.hex(' ')}), "
                f"expected {item.size} ({item.type_name})"
            )
        return value

    def _download(self, value: int, item: EdsObject) -> None:
        """Write an object; a request without an answer is repeated.

        Raises:
            StartupError: the object's type cannot hold the value.
        """
        try:
            data = struct.pack("<" + item.code, value)
        except struct.error:
            raise StartupError(
                f"{self.where(item.index, item.sub)}: {value} does not fit into it, it is {item.type_name}"
            ) from None
        repeated(lambda: self.remote.sdo.download(item.index, item.sub, data))

    def write(self, value: int, index: int, sub: int = 0, *, verify: bool = True) -> int:
        """Write an object and read it back."""
        with self._errors_named(index, sub, f"{value:#x} refused"):
            self._download(value, self._objects[index, sub])
        return self.expect(value, index, sub) if verify else value

    def expect(self, value: int, index: int, sub: int = 0) -> int:
        """Check that an object holds ``value``."""
        found = self.read(index, sub)
        if found != value:
            raise StartupError(f"{self.where(index, sub)}: found {found:#x}, expected {value:#x}")
        self.watch(found, index, sub)
        return found

    def watch(self, value: int, index: int, sub: int = 0, name: str = "") -> None:
        """Have the loop check that an object keeps ``value``."""
        entry = self._objects[index, sub]
        size = entry.size
        self._verified.pop((index, sub), None)
        self._verified[index, sub] = Watched(
            self.id, index, sub, size, value & (1 << 8 * size) - 1, name or entry.name,
            round(self.remote.sdo.RESPONSE_TIMEOUT * 1000),
            self._section == "cylinder" and (index, sub) in od.DRIVE_OBEYS_BY,
        )  # fmt: skip

    def enforce(self, name: str, wanted: int, index: int, sub: int) -> StopSetting:
        """Write a setting and read it back; a refusal or another value is no error here but in the result."""
        what = f"0x{index:04X}:{sub:02X}" if sub else f"0x{index:04X}"
        if not self.has(index, sub):
            return StopSetting(name, what, wanted, None, "not in its EDS file")
        item, why = self._objects[index, sub], ""
        with self._errors_named(index, sub):
            try:
                self._download(wanted, item)
            except canopen.SdoAbortedError as error:
                why = f"refused: {error}"
            try:
                found = StopSetting(name, what, wanted, repeated(lambda: self._upload(item)), why)
            except canopen.SdoAbortedError as error:
                return StopSetting(name, what, wanted, None, f"cannot be read: {error}")
        if found.ok:
            self.watch(wanted, index, sub, name)
        return found

    @property
    def reported(self) -> NmtState | None:
        """NMT state in the device's newest heartbeat; None: none has come."""
        return self._bus.reported.get(self.id)

    def await_answer(
        self, index: int, until_ns: int, say: Callable[[str], None], ends: Callable[[], bool] = lambda: False
    ) -> bool:
        """Read an object until the device answers, at most until ``until_ns`` or ``ends()``; whether it was waited for.

        Raises:
            SilentError: it does not answer.
            StartupError: its answer is no SDO answer.
        """
        waited = False
        while True:
            try:
                self.read(index, tries=1)
            except SilentError:
                left_s = (until_ns - self._bus.now_ns()) * 1e-9
                if left_s <= 0 or ends():
                    raise
                if not waited:
                    say(f"waiting for {self.name} (node {self.id}), for {left_s:.0f} s more at most (can.boot_wait_s)")
                    waited = True
                again_ns = self._bus.until_ns(min(left_s, _ASK_AGAIN_S))  # a wrong answer may come at once
                self._bus.hear(lambda: False, again_ns)
            else:
                return waited

    def await_boot(self, until_ns: int, say: Callable[[str], None]) -> None:
        """Wait until the device answers, at most until ``until_ns``; see `await_answer`."""
        self.await_answer(od.DEVICE_TYPE, until_ns, say)
        self.remote.nmt.state = "PRE-OPERATIONAL"  # a device that has just booted, or lost a frame, missed the first

    def error(self) -> str:
        """The error that the device reports now, in words; "": none."""
        register = self.read(od.ERROR_REGISTER)
        if not register:
            return ""
        code = self.read(od.ERROR_CODE) if self.has(od.ERROR_CODE) else 0
        if not code and self.has(od.ERROR_FIELD, 1) and self.read(od.ERROR_FIELD):
            code = self.read(od.ERROR_FIELD, 1) & 0xFFFF
        known = f", error 0x{code:04X}, {emergency.code_words(code)}" if code else ""
        return f"{self.name} (node {self.id}) reports {emergency.register_words(register)}{known}"

    def reset_communication(self, until_ns: int, say: Callable[[str], None]) -> None:
        """NMT reset communication, which ends errors that outlive their cause; the device boots anew.

        The command is repeated once without the boot-up message. ``say`` gets a line where the reset shows no effect.

        Raises:
            StartupError: it does not answer afterwards.
        """
        booted = self._boots_anew() or self._boots_anew()
        self.await_answer(od.DEVICE_TYPE, until_ns, say)
        self.remote.nmt.state = "PRE-OPERATIONAL"
        if not booted:
            say(f"{self.name} (node {self.id}): no boot-up message after two commands to reset communication")
        if error := self.error():
            say(f"{error}, also after reset communication")

    def _boots_anew(self) -> bool:
        """Send "reset communication"; whether the boot-up message comes."""
        self._bus.reported.pop(self.id, None)
        self.remote.nmt.state = "RESET COMMUNICATION"
        return self._bus.hear(lambda: self.reported is NmtState.BOOT_UP, self._bus.until_ns(_BOOT_S))

    def identity(self, profile: int) -> Device:
        """Identity of the device, which must be of this CiA profile."""
        device_type = self.read(od.DEVICE_TYPE)
        if device_type & 0xFFFF != profile & 0xFFFF:
            raise StartupError(
                f"{self.name} (node {self.id}): found CiA profile {device_type & 0xFFFF}, expected {profile & 0xFFFF}"
            )
        found = Device(self.name, self.id, device_type, *(self.read(od.IDENTITY, sub) for sub in (1, 2, 3, 4)))
        for sub, what in enumerate(("vendor", "product"), 1):
            expected = getattr(self._device, what)
            if expected is not None and getattr(found, what) != expected:
                raise StartupError(
                    f"{self.where(od.IDENTITY, sub)}: found {what} {getattr(found, what):#x}, "
                    f"expected {expected:#x} ({self._section}.{what} in the rig file)"
                )
        return found

    def map_pdo(
        self, layout: od.PdoLayout, transmission: int, timers: Mapping[int, int] = MappingProxyType({})
    ) -> od.PdoLayout:
        """Map ``layout`` onto its PDO and enable it; values already right are not written. Returns the layout in use.

        CiA 301 order: disable, clear, write, count, enable. Bit 30 of the COB-ID stays unchanged, because a device
        without RTR refuses another. A fixed mapping is used if it has all objects of ``layout``.

        Args:
            layout: the objects needed.
            transmission: type, sub-index 2.
            timers: inhibit time and event timer of one that is not driven by SYNC, by sub-index.
        """
        communication = layout.communication
        found = self.read(communication, 1)
        cob_id = layout.cob_base + self.id | found & od.PDO_NO_RTR
        parameters = {2: transmission, **timers}
        mapped = self._mapping(layout.mapping_object)
        same = found == cob_id and mapped == layout.mapping
        if not (same and all(self.read(communication, sub) == value for sub, value in parameters.items())):
            self.write(cob_id | od.PDO_NOT_VALID, communication, 1, verify=False)
            for sub, value in parameters.items():
                self.write(value, communication, sub)
            if mapped != layout.mapping:
                layout = self._remap(layout, mapped)
            self.write(cob_id, communication, 1)
        for sub, value in {1: cob_id, **parameters}.items():  # also values that were right already
            self.watch(value, communication, sub)
        for sub, value in enumerate((len(layout.mapping), *layout.mapping)):
            self.watch(value, layout.mapping_object, sub)
        return layout

    def _mapping(self, index: int) -> tuple[int, ...]:
        entries = self.read(index, 0)
        return tuple(self.read(index, sub) for sub in range(1, entries + 1)) if entries <= MOST_ENTRIES else ()

    def _remap(self, layout: od.PdoLayout, mapped: tuple[int, ...]) -> od.PdoLayout:
        """Write the mapping of a PDO that is switched off; returns the layout in use."""
        index = layout.mapping_object
        with self._errors_named(index, 0):
            try:
                self._download(0, self._objects[index, 0])
            except canopen.SdoAbortedError as error:  # the mapping is fixed
                try:
                    return layout.as_mapped(mapped)
                except ValueError as missing:
                    raise StartupError(
                        f"{self.where(index, 0)}: a mapping that cannot be changed ({error}) has {missing}: "
                        "use another PDO or object of the device, or another device"
                    ) from None
        self.expect(0, index)
        for sub, entry in enumerate(layout.mapping, 1):
            self.write(entry, index, sub)
        self.write(len(layout.mapping), index, 0)
        return layout
