"""A CANopen device under configuration, by SDO: what is written is read back, and errors name device and object."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import canopen

from rigctl.config import RigSettings
from rigctl.devices import objects as od
from rigctl.devices.sdo import Watched

_NOT_VALID = 1 << 31
_MOST_SEGMENTS = 4  # no object read here is longer than one
_GARBLED = (struct.error, canopen.ObjectDictionaryError)  # canopen's, at frames too short and values of no such size


class StartupError(RuntimeError):
    """The rig is not what the rig file says, or does not answer; ``str()`` is one line."""


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
    """One setting of the drive's own stop: what was written, and what was read back; ``why`` where that failed."""

    name: str
    object: str
    wanted: int
    found: int | None
    why: str = ""

    @property
    def ok(self) -> bool:
        """The drive has it."""
        return self.found == self.wanted


class RemoteNode:
    """One device under configuration, with errors that name it."""

    def __init__(self, network: canopen.Network, settings: RigSettings, name: str, node: int, eds: str) -> None:
        self.name, self.id = name, node
        self._channel = f"{settings.can.interface}:{settings.can.channel}"
        self.remote = network.add_node(canopen.RemoteNode(node, str(settings.file(eds))))
        self._verified: dict[tuple[int, int], Watched] = {}

    @property
    def verified(self) -> list[Watched]:
        """Every object that was read back as it must be, with its last value: what the loop goes on watching."""
        return list(self._verified.values())

    def where(self, index: int, sub: int) -> str:
        """Device and object, for an error."""
        return f"{self.name} (node {self.id}), object 0x{index:04X}:{sub:02X}"

    def _variable(self, index: int, sub: int) -> Any:
        entry = self.remote.sdo[index]
        return entry[sub] if hasattr(entry, "__getitem__") and not hasattr(entry, "raw") else entry

    def has(self, index: int, sub: int = 0) -> bool:
        """An object that is optional in its profile is in its EDS file."""
        try:
            self._variable(index, sub)
        except KeyError:
            return False
        return True

    def read(self, index: int, sub: int = 0) -> int:
        """Value of an object."""
        try:
            return self._upload(self._variable(index, sub))
        except canopen.SdoAbortedError as error:
            raise StartupError(f"{self.where(index, sub)}: cannot be read: {error}") from None
        except _GARBLED:
            raise self._garbled(index, sub) from None
        except canopen.SdoCommunicationError:
            raise StartupError(
                f"{self.name} (node {self.id}) does not answer on {self._channel}: is the rig on and connected?"
            ) from None
        except KeyError:
            raise StartupError(f"{self.where(index, sub)}: not in its EDS file") from None

    def _upload(self, variable: Any) -> int:
        """An object's value; canopen's own way would go on for as long as a device sends segments."""
        data = b""
        with self.remote.sdo.open(variable.od.index, variable.od.subindex, "rb", buffering=0) as stream:
            for _ in range(_MOST_SEGMENTS):
                if not (part := stream.read(7)):
                    return int(variable.od.decode_raw(data[: len(variable.od) // 8]))
                data += part
        raise canopen.ObjectDictionaryError("it does not end")

    def write(self, value: int, index: int, sub: int = 0, *, verify: bool = True) -> int:
        """Write an object and read it back."""
        try:
            self._variable(index, sub).raw = value
        except canopen.SdoAbortedError as error:
            raise StartupError(f"{self.where(index, sub)}: {value:#x} refused: {error}") from None
        except _GARBLED:
            raise self._garbled(index, sub) from None
        except canopen.SdoCommunicationError:
            raise self._silent() from None
        except KeyError:
            raise StartupError(f"{self.where(index, sub)}: not in its EDS file") from None
        return self.expect(value, index, sub) if verify else value

    def expect(self, value: int, index: int, sub: int = 0) -> int:
        """An object must hold ``value``."""
        found = self.read(index, sub)
        if found != value:
            raise StartupError(f"{self.where(index, sub)}: found {found:#x}, allowed {value:#x}")
        self.watch(found, index, sub)
        return found

    def watch(self, value: int, index: int, sub: int = 0, name: str = "") -> None:
        """An object must keep ``value`` while the loop runs."""
        entry = self._variable(index, sub).od
        size = max(1, len(entry) // 8)  # a BOOLEAN has 1 bit
        self._verified.pop((index, sub), None)
        self._verified[index, sub] = Watched(
            self.id, index, sub, size, value & (1 << 8 * size) - 1, name or entry.name,
            round(self.remote.sdo.RESPONSE_TIMEOUT * 1000), (index, sub) in od.DRIVE_OBEYS_BY,
        )  # fmt: skip

    def enforce(self, name: str, wanted: int, index: int, sub: int) -> StopSetting:
        """Write a setting and read it back; a drive that refuses it, or keeps another, is no error here."""
        what = f"0x{index:04X}:{sub:02X}" if sub else f"0x{index:04X}"
        try:
            variable = self._variable(index, sub)
        except KeyError:
            return StopSetting(name, what, wanted, None, "not in its EDS file")
        why = ""
        try:
            variable.raw = wanted
        except canopen.SdoAbortedError as error:
            why = f"refused: {error}"
        except _GARBLED:
            raise self._garbled(index, sub) from None
        except canopen.SdoCommunicationError:
            raise self._silent() from None
        try:
            found = StopSetting(name, what, wanted, self._upload(variable), why)
            if found.ok:
                self.watch(wanted, index, sub, name)
            return found
        except canopen.SdoAbortedError as error:
            return StopSetting(name, what, wanted, None, f"cannot be read: {error}")
        except _GARBLED:
            raise self._garbled(index, sub) from None
        except canopen.SdoCommunicationError:
            raise self._silent() from None

    def _garbled(self, index: int, sub: int) -> StartupError:
        return StartupError(f"{self.where(index, sub)}: answered with what is no SDO answer on {self._channel}")

    def _silent(self) -> StartupError:
        return StartupError(f"{self.name} (node {self.id}) stopped answering on {self._channel}")

    def identity(self, profile: int) -> Device:
        """Identity, of a device of this CiA profile."""
        device_type = self.read(od.DEVICE_TYPE)
        if device_type & 0xFFFF != profile & 0xFFFF:
            raise StartupError(
                f"{self.name} (node {self.id}): found CiA profile {device_type & 0xFFFF}, allowed {profile & 0xFFFF}"
            )
        numbers = (self.read(od.IDENTITY, sub) for sub in (1, 2, 3, 4))
        return Device(self.name, self.id, device_type, *numbers)

    def map_pdo(
        self,
        layout: od.PdoLayout,
        communication: int,
        mapping: int,
        transmission: int,
        timers: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """Map ``layout`` onto a PDO, CiA 301 order: disable, clear, write, count, enable.

        ``timers``: inhibit time and event timer of one that is not driven by SYNC, by sub-index.
        """
        cob_id = layout.cob_base + self.id
        self.write(cob_id | _NOT_VALID, communication, 1, verify=False)
        self.write(transmission, communication, 2)
        for sub, value in timers.items():
            self.write(value, communication, sub)
        self.write(0, mapping, 0)
        for sub, entry in enumerate(layout.mapping, 1):
            self.write(entry, mapping, sub)
        self.write(len(layout.mapping), mapping, 0)
        self.write(cob_id, communication, 1)
