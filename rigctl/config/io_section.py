"""The `io` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.settings_base import CanopenDevice, require

INPUTS_PER_BLOCK = 8  # CiA 401 0x6000, 0x6200: one sub-index each
LOST_SAMPLES = 3


class IoSettings(CanopenDevice):
    """Generic I/O node, CiA 401, that mirrors the emergency stop's contact. The rig runs without one.

    The node sends on a change of an input and by its event timer, so that its silence is detected. An output of it may
    be wired to the drive's input for safe torque off (IEC 61800-5-2: STO): the last resort against a drive that no
    command on the bus stops. The node drops it by itself when it loses the daemon's heartbeat.
    """

    node: int = Field(default=6, ge=1, le=127, description="CANopen node id")
    eds: str = Field(default="eds/io_node.eds", min_length=1, description="EDS file, relative to the rig file")
    e_stop_input: int = Field(
        ge=0, le=63, description="digital input, from 0 on (0x6000:01 has 0 to 7), 0 = pressed, 1 = contact closed"
    )
    drive_enable_output: int | None = Field(
        default=None, ge=0, le=63, description="digital output at the drive's STO input, 1 = torque; null = not wired"
    )
    drive_off_input: int | None = Field(
        default=None, ge=0, le=63, description="digital input with the drive's STO feedback, 1 = without torque"
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
        output, feedback = self.drive_enable_output, self.drive_off_input
        both = (output is None) is (feedback is None)
        allowed = "one where drive_enable_output has one: an output that is not seen to act is no last resort"
        require(both, "drive_off_input", feedback, allowed)
        if feedback is not None:
            near = feedback // INPUTS_PER_BLOCK == self.block - 1 and feedback != self.e_stop_input
            first = (self.block - 1) * INPUTS_PER_BLOCK
            allowed = f"another of the eight inputs of e_stop_input ({first} to {first + INPUTS_PER_BLOCK - 1})"
            require(near, "drive_off_input", feedback, allowed)
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

    @property
    def off_mask(self) -> int:
        """Bit of ``drive_off_input`` in the same block; 0 without one."""
        return 0 if self.drive_off_input is None else 1 << self.drive_off_input % INPUTS_PER_BLOCK

    @property
    def enable_block(self) -> int:
        """Sub-index of 0x6200 that has ``drive_enable_output``; 0 without one."""
        return 0 if self.drive_enable_output is None else self.drive_enable_output // INPUTS_PER_BLOCK + 1

    @property
    def enable_mask(self) -> int:
        """Bit of that output in its block; 0 without one."""
        return 0 if self.drive_enable_output is None else 1 << self.drive_enable_output % INPUTS_PER_BLOCK
