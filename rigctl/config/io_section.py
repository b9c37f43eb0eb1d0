"""The `io` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.settings_base import CanopenDevice, require

INPUTS_PER_BLOCK = 8  # CiA 401 0x6000: one sub-index each
LOST_SAMPLES = 3


class IoSettings(CanopenDevice):
    """Generic I/O node, CiA 401, that mirrors the emergency stop's contact. The rig runs without one.

    The node sends on a change of an input and by its event timer, so that its silence is detected.
    """

    node: int = Field(default=6, ge=1, le=127, description="CANopen node id")
    eds: str = Field(default="eds/io_node.eds", min_length=1, description="EDS file, relative to the rig file")
    e_stop_input: int = Field(
        ge=0, le=63, description="digital input, from 0 on (0x6000:01 has 0 to 7), 0 = pressed, 1 = contact closed"
    )
    event_ms: int = Field(default=20, ge=5, le=1000, description="it sends at least this often (0x1800:05)")
    inhibit_ms: int = Field(
        default=5, ge=1, le=1000, description="and at most this often (0x1800:03); a press may be seen as much later"
    )
    stale_ms: int = Field(default=100, ge=15, le=5000, description="an input older than this is not seen")

    @model_validator(mode="after")
    def _is_heard_in_time(self) -> IoSettings:
        event, least = self.event_ms, LOST_SAMPLES * self.event_ms
        require(self.inhibit_ms <= event, "inhibit_ms", self.inhibit_ms, f"at most event_ms ({event})")
        require(self.stale_ms >= least, "stale_ms", self.stale_ms, f"{LOST_SAMPLES} times event_ms ({least}) or more")
        return self

    @property
    def block(self) -> int:
        """Sub-index of 0x6000 that has the input."""
        return self.e_stop_input // INPUTS_PER_BLOCK + 1

    @property
    def mask(self) -> int:
        """Bit of the input in that block."""
        return 1 << self.e_stop_input % INPUTS_PER_BLOCK
