"""The `can` section of a rig file."""

from __future__ import annotations

import difflib

from pydantic import Field, model_validator

from rigctl.config import address
from rigctl.config.one_line import on_one_line
from rigctl.config.settings_base import NodeId, Settings, require

OWN = frozenset({"socketcan", "rigsim"})
"""Interfaces that need nothing beside this program and the kernel."""


class CanSettings(Settings):
    """The one CAN bus the loop owns."""

    interface: str = Field(min_length=1, description="python-can interface: socketcan, rigsim, ...")
    channel: str = Field(min_length=1, max_length=100, description="device or socket, e.g. can0")
    bitrate_bit_s: int | None = Field(
        ge=10_000, le=1_000_000, description="bit rate; null only on rigsim, which has no bit timing"
    )
    controller_node: NodeId = 1
    heartbeat_ms: int = Field(default=20, ge=5, le=1000, description="our heartbeat period (0x1017)")
    boot_wait_s: float = Field(default=10.0, ge=0, le=120, description="start-up waits so long for devices to boot")

    @model_validator(mode="after")
    def _bit_rate_is_known(self) -> CanSettings:
        known = self.bitrate_bit_s is not None or self.interface == "rigsim"
        require(known, "bitrate_bit_s", None, "a bit rate (null is for interface rigsim only)")
        fits = self.interface != "rigsim" or address.is_socket_path(self.channel)
        require(fits, "channel", self.channel, address.PATH_ALLOWED)
        return self


def unknown_interface(can: CanSettings) -> str | None:
    """Why python-can has no such interface, in words; None: it has it."""
    if can.interface in OWN:
        return None
    from can import VALID_INTERFACES  # python-can takes 0.2 s to import

    known = sorted(VALID_INTERFACES)
    if can.interface in known:
        return None
    near = difflib.get_close_matches(can.interface, known, n=1)
    hint = f" ({near[0]}?)" if near else ""
    return f"found {on_one_line(can.interface)}{hint}, expected an interface of python-can: {', '.join(known)}"
