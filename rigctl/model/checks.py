"""The checks an arm command must pass: bit, name, and the failure with its remedy in words.

The conditions are in `rigctl.control.watch.safety.preflight`.
"""

from __future__ import annotations

from enum import IntFlag


class Check(IntFlag):
    """Preflight checks an arm command must pass. ``words``: the operator reads them where a check fails."""

    words: str

    def __new__(cls, bit: int, words: str = "") -> Check:
        """A member with its words."""
        member = int.__new__(cls, bit)
        member._value_ = bit
        member.words = words
        return member

    def __invert__(self) -> Check:
        """All other checks.

        The one of Python 3.11.2, Debian 12's own, leaves out every bit above those of a flag that has a ``__new__``.
        """
        return Check(_EVERY & ~self._value_)

    CELL_STALE = (
        1 << 0,
        "no fresh tension sample: check the cell's power and cable",
    )
    CELL_INVALID = (
        1 << 1,
        "tension cell reports overload or no valid value: unload it, check its cable",
    )
    INCLINATION_STALE = (
        1 << 2,
        "no fresh inclination sample: check the inclinometer's power and cable",
    )
    INCLINATION_INVALID = (
        1 << 3,
        "inclinometer reports no valid value: check its mounting and range",
    )
    DRIVE_STALE = (
        1 << 4,
        "no fresh drive status: check the drive's power and cable",
    )
    DRIVE_FAULT = (
        1 << 5,
        "drive reports a fault (reset clears it)",
    )
    TENSION_HIGH = (
        1 << 6,
        "tension above its limit: unload the rope",
    )
    STROKE_RANGE = (
        1 << 7,
        "stroke beyond its limits: bring it back by hand or with the drive's own tool",
    )
    # The drive's own stop was not verified (0x1016, 0x6007, 0x605E, deadline)
    DRIVE_SUPERVISION = (
        1 << 8,
        (
            "the devices do not keep what start-up wrote, or a device started anew (see the events): start the daemon "
            "anew, it writes all of it again"
        ),
    )
    # The cell's calibration is missing or overdue, and not waived
    CALIBRATION = (
        1 << 9,
        "tension cell's calibration is missing or overdue: rigctl calibrate (or calibration.waiver)",
    )
    # The emergency stop is pressed: the drive's input
    E_STOP = (
        1 << 10,
        "emergency stop is pressed (drive's input): release it",
    )
    # The cell's reading is stuck, noisy or negative
    CELL_IMPLAUSIBLE = (
        1 << 11,
        "tension cell is stuck, noisy or reads a push: check cable and amplifier",
    )
    # A device has sent an emergency message and not withdrawn it
    EMERGENCY = (
        1 << 12,
        "a device's emergency message is active (see the events)",
    )
    # A limit of the rig file with an action is exceeded now
    LIMIT = (
        1 << 13,
        "a limit of the rig file is passed, or its signal does not come (rigctl watch shows the signals)",
    )
    # An emergency stop is fitted, but the state of the drive's input is unknown
    E_STOP_UNSEEN = (
        1 << 14,
        "emergency stop's input is not seen: check the drive's second TPDO (cylinder.e_stop_input)",
    )
    # The stroke is within the margin of an end; ``arm --near-end`` allows that
    STROKE_NEAR_END = (
        1 << 15,
        (
            "stroke too near its end (preflight.stroke_margin_mm): rigctl arm --near-end, then tension or release, "
            "whichever leads away from it"
        ),
    )
    # No valid tare is on record, and this is not waived
    TARE = (
        1 << 16,
        "no tare on record that still holds: rigctl tare (or calibration.waiver)",
    )
    # The margins of the law in use are missing or refused
    MARGINS = (
        1 << 17,
        "no accepted margins of the law in use: rigctl tune",
    )
    # The system refused a real-time setting, and this is not waived
    REALTIME = (
        1 << 18,
        "real-time settings are not in force: rigctl doctor (or loop.realtime_waiver)",
    )
    # A disk that the rig writes to has too little room or is not writable
    DISK = (
        1 << 19,
        "disk nearly full: make room for ledger, audit log and trip dumps",
    )
    # Another controller commands this bus
    RIVAL = (
        1 << 21,
        "another controller commands this bus: find it and stop it",
    )
    # The emergency stop is pressed: the I/O node's input
    E_STOP_IO = (
        1 << 22,
        "emergency stop is pressed (I/O node's input): release it",
    )
    # An I/O node is fitted, but the state of its input is unknown
    E_STOP_IO_UNSEEN = (
        1 << 23,
        "emergency stop's input on the I/O node is not seen: check the node's power and cable",
    )
    # The drive does not send current, temperature and inputs
    STATUS_STALE = (
        1 << 24,
        "no current, temperature and inputs of the drive: check its second TPDO (cylinder.status_rate_hz)",
    )
    # Another master commands the drive, or the drive limits our commands
    DRIVE_REFUSES = (
        1 << 25,
        (
            "drive is not ours to command: somebody else has enabled it, its remote bit is off, or a limit of its own "
            "is active (statusword bits 9, 11): withdraw its panel or service tool, look at its display"
        ),
    )
    # A device sends no heartbeat, or one with another state than OPERATIONAL
    NODE_NOT_OPERATIONAL = (
        1 << 26,
        "a device sends no heartbeat or is not operational: check its power and cable",
    )
    # The stroke has moved within the last STILL_NS, see rigctl.control.power.power_seen
    NOT_AT_STANDSTILL = (
        1 << 29,
        (
            "the stroke does not stand still (within 0.02 mm and below 0.05 mm/s for 0.2 s): wait; if it goes on, the "
            "brake slips"
        ),
    )
    # The drive is not off, or its brake has not had its time to close
    SEQUENCE_RUNNING = (
        1 << 30,
        (
            "the drive is not off with its brake closed yet (cylinder.brake_delay_ms): wait a second; if it goes on, "
            "switch the drive's power off and on"
        ),
    )
    # The host checks above are unknown: the gateway has not evaluated them within the last seconds
    HOST = (
        1 << 20,
        "tare, margins, real time and disk have not been looked at: try again in a second",
    )
    # The drive's position is not the stroke that was last known
    STROKE_UNCONFIRMED = (
        1 << 27,
        (
            "the stroke is not the one last known (see the events): measure it at the cylinder, then rigctl "
            "confirm-stroke MM"
        ),
    )

    # The second force path sends nothing good, or no tare has given it a zero
    SECOND_FORCE = (
        1 << 34,
        "no second force path (second_force): check its device; if it sends, rigctl tare with the rope unloaded",
    )
    # The two force paths disagree
    FORCES_DISAGREE = (
        1 << 35,
        (
            "the two force paths disagree (second_force.disagree_n): find the wrong one with a known weight, then "
            "rigctl tare and calibrate"
        ),
    )

    # The drive's STO feedback does not follow its hard-wired enable
    ENABLE_IGNORED = (
        1 << 36,
        (
            "the drive's STO feedback (io.drive_off_input) does not follow its hard-wired enable "
            "(io.drive_enable_output): check wire, relay and feedback"
        ),
    )


_EVERY = sum(check.value for check in Check)
HOST_CHECKS = Check.TARE | Check.MARGINS | Check.REALTIME | Check.DISK | Check.HOST
"""Checks the loop cannot make itself, see `rigctl.operations.preflight`."""
