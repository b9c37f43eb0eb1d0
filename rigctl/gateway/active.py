"""The active configuration: what runs, with the gains and the calibration in force; published whenever it changes."""

from __future__ import annotations

import threading
from typing import Any

import msgspec

from rigctl.ipc.ledger import IN_FORCE
from rigctl.ipc.runtime_folder import ACTIVE, Runtime

CONTROL = "control.json"
_FILES = {ACTIVE: None, CONTROL: "control", IN_FORCE: "calibration"}  # file: its key in the message, None: top level


class ReplacedFile:
    """A file of the runtime folder that another process or thread replaces; read again only after a replacement."""

    def __init__(self, runtime: Runtime, name: str) -> None:
        self._runtime, self._name = runtime, name
        self._mark: tuple[int, ...] | None = None
        self.value: dict[str, Any] = {}

    def read(self) -> bool:
        """Read the file if it was replaced; returns whether its value changed. An unreadable file counts as empty."""
        try:
            mark = self._runtime.mark(self._name)
            if mark == self._mark:
                return False
            value = self._runtime.read_json(self._name)
        except (OSError, msgspec.MsgspecError):
            mark, value = (), {}
        changed, self._mark, self.value = value != self.value, mark, value
        return changed


class ActiveConfiguration:
    """The message ``cfg/active``; may be used from any thread."""

    def __init__(self, runtime: Runtime) -> None:
        self._files = {name: ReplacedFile(runtime, name) for name in _FILES}
        self._reading = threading.Lock()
        self._payload = b"{}"
        self.read()

    @property
    def written(self) -> dict[str, Any]:
        """Settings and the design in use, as supervisor and calibration service wrote them, at the last `read`."""
        return self._files[ACTIVE].value

    @property
    def control(self) -> dict[str, Any]:
        """What the control process read back from the devices, at the last `read`."""
        return self._files[CONTROL].value

    def read(self) -> bytes:
        """The current message; the same object while nothing has changed."""
        with self._reading:
            changed = [file.read() for file in self._files.values()]
            if any(changed):
                whole: dict[str, Any] = {}
                for name, key in _FILES.items():
                    whole |= self._files[name].value if key is None else {key: self._files[name].value}
                self._payload = msgspec.json.encode(whole)
            return self._payload
