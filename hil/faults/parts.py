"""The part that is to be named for each fault of the catalogue; two where signals cannot decide by nature."""

from __future__ import annotations

import functools
from fnmatch import fnmatchcase

from rigctl.diagnosis.part import Part

CELL = (Part.CELL, Part.AMPLIFIER)
"""Of a reading that is wrong: cell, cable and amplifier have one output."""

PARTS: tuple[tuple[str, tuple[Part, ...]], ...] = (
    # Of two faults at once, either
    ("encoder_stuck_creeps_*", (Part.ENCODER, Part.DRIVE)),
    ("encoder_stuck_brake_slips_*", (Part.ENCODER, Part.BRAKE)),
    ("cell_frozen_encoder_drifts_*", (*CELL, Part.ENCODER)),
    ("cell_stuck_then_*", (Part.AMPLIFIER, Part.DRIVE, Part.BRAKE)),
    ("encoder_drifts_then_*", (Part.ENCODER, Part.AMPLIFIER, Part.BRAKE)),
    ("cell_silent_then_*", (Part.AMPLIFIER, Part.BRAKE)),
    ("runs_away_then_*", (Part.DRIVE, Part.MASTER)),
    ("cell_silent_encoder_drifts_*", (Part.AMPLIFIER, Part.ENCODER)),
    # Faults inside transitions and on other rigs, by their own ending; the last of a sequence
    ("*_[0-9]*_cell_jumps", CELL),
    ("*_cell_silent", (Part.AMPLIFIER,)),
    ("cell_silent_reset", (Part.AMPLIFIER,)),
    ("*_[0-9]*_encoder_drifts", (Part.ENCODER,)),
    ("*_[0-9]*_brake_*", (Part.BRAKE,)),
    ("*_[0-9]*_hangs", (Part.COMPUTER,)),
    ("*_[0-9]*_creeps", (Part.DRIVE,)),
    ("*_[0-9]*_runs", (Part.DRIVE,)),
    ("*_cell_gain", CELL),
    ("*_encoder_gain", (Part.ENCODER,)),
    ("*_cell_jumps", CELL),
    ("*_sync_lost", (Part.BUS,)),
    ("stiff_*", (Part.DRIVE,)),
    ("highest_*", (Part.DRIVE,)),
    ("unlimited_*", (Part.DRIVE,)),
    ("encoder_drifts_reset_tension", (Part.ENCODER,)),
    ("*_reset_tension*", (Part.DRIVE,)),
    # Other masters
    ("*_nmt_*", (Part.MASTER,)),
    ("nmt_*", (Part.MASTER,)),
    ("foreign_*", (Part.MASTER,)),
    ("sync_foreign*", (Part.MASTER,)),
    ("rival_commands", (Part.MASTER,)),
    ("impostor", (Part.MASTER,)),
    ("drive_tool*", (Part.MASTER, Part.DRIVE)),
    # Cell and amplifier
    ("cell_silent", (Part.AMPLIFIER,)),
    ("cell_stuck", (Part.AMPLIFIER,)),
    ("cell_emergency*", (Part.AMPLIFIER,)),
    ("cell_reboots", (Part.AMPLIFIER,)),
    ("cell_back_in_error*", (Part.AMPLIFIER,)),
    ("cell_no_heartbeat", (Part.AMPLIFIER,)),
    ("cell_length_wrong", (Part.AMPLIFIER,)),
    ("cell_*", CELL),
    ("minutes_cell_*", CELL),
    ("second_force_wrong", (Part.SECOND_FORCE, Part.CELL)),
    ("second_force_*", (Part.SECOND_FORCE,)),
    ("slope_*", (Part.INCLINOMETER,)),
    # I/O and emergency stop
    ("io_e_stop*", (Part.E_STOP,)),
    ("arm_during_run_out", (Part.E_STOP,)),
    ("reset_during_quick_stop", (Part.E_STOP,)),
    ("io_*", (Part.IO_NODE,)),
    ("enable_welded", (Part.IO_NODE,)),
    ("rail_*", (Part.RAIL_ENCODER,)),
    # Bus
    ("frames_*", (Part.BUS,)),
    ("burst_*", (Part.BUS,)),
    ("bus_stalled", (Part.COMPUTER,)),
    ("bus_*", (Part.BUS,)),
    ("babble_*", (Part.BUS,)),
    ("error_passive", (Part.BUS,)),
    ("length_wrong_1pct", (Part.BUS,)),
    ("power_dip", (Part.BUS,)),
    ("sync_lost*", (Part.BUS,)),
    ("sync_twice*", (Part.BUS,)),
    # Drive, encoder, brake
    ("stroke_end_high", (Part.PAYLOAD,)),
    ("stroke_end_*", (Part.ROPE,)),
    ("stroke_*", (Part.ENCODER,)),
    ("speed_*", (Part.ENCODER,)),
    ("encoder_*", (Part.ENCODER,)),
    ("position_drifts*", (Part.ENCODER,)),
    ("minutes_encoder_*", (Part.ENCODER,)),
    ("drive_runs_blind", (Part.DRIVE, Part.ENCODER)),
    ("drive_frozen*", (Part.DRIVE, Part.BUS)),
    ("drive_*", (Part.DRIVE,)),
    ("status_*", (Part.DRIVE,)),
    ("sdo_silent", (Part.DRIVE,)),
    ("sync_unheard*", (Part.DRIVE,)),
    ("controlword_slow_stop*", (Part.AMPLIFIER, Part.DRIVE)),
    ("*_persists*", (Part.AMPLIFIER, Part.DRIVE)),
    ("controlword_*", (Part.DRIVE,)),
    ("enabling_*", (Part.DRIVE,)),
    ("torque_*", (Part.DRIVE,)),
    ("rpdo_*", (Part.DRIVE,)),
    ("lost_*", (Part.DRIVE,)),
    ("creep_*", (Part.DRIVE,)),
    ("minutes_motor_*", (Part.DRIVE,)),
    ("motor_motionless_*", (Part.DRIVE,)),
    ("backlash_doubled", (Part.DRIVE,)),
    ("brake_*", (Part.BRAKE,)),
    # Rope, spring, payload
    ("rope_*", (Part.ROPE,)),
    ("spring_*", (Part.ROPE,)),
    ("payload_*", (Part.PAYLOAD,)),
    # Computer and processes
    ("controller_hangs", (Part.COMPUTER,)),
    ("overrun_*", (Part.COMPUTER,)),
    ("control_*", (Part.PROCESS,)),
    ("*_killed", (Part.PROCESS,)),
    ("*_stopped", (Part.PROCESS,)),
    ("folder_deleted", (Part.PROCESS,)),
    ("terminal_gone", (Part.PROCESS,)),
    ("disk_full", (Part.COMPUTER,)),
    ("clock_*", (Part.COMPUTER,)),
    ("config_replaced", (Part.PROCESS,)),
)
"""Patterns of ids; the first that matches is a fault's."""


@functools.cache
def parts_of(fault_id: str) -> tuple[Part, ...]:
    """The parts of a fault, any of which may be named for it; on a parked rig they are the same.

    Raises:
        LookupError: no row has it.
    """
    for pattern, parts in PARTS:
        if fnmatchcase(fault_id.removesuffix("_parked"), pattern):
            return parts
    raise LookupError(f"no part is stated for {fault_id}")


DRAWN: dict[str, tuple[Part, ...]] = {
    **dict.fromkeys(("cell_frozen", "cell_drifts", "cell_gain", "cell_jumps", "cell_noisy"), CELL),
    **dict.fromkeys(("cell_stuck", "cell_silent"), (Part.AMPLIFIER,)),
    **dict.fromkeys(
        ("encoder_stuck", "encoder_drifts", "position_drifts", "encoder_gain", "speed_stuck"), (Part.ENCODER,)
    ),
    **dict.fromkeys(
        ("drive_creeps", "drive_gain", "drive_ignores", "drive_runs", "rpdo_ignored", "rpdo_frozen", "rpdo_late",
         "drive_trips", "drive_lies_off", "drive_reports_off", "sync_unheard", "watch_lost", "backlash_grows"),
        (Part.DRIVE,),
    ),
    **dict.fromkeys(("drive_samples_frozen", "drive_silent"), (Part.DRIVE, Part.BUS)),
    **dict.fromkeys(("sync_lost", "sync_twice", "frames_lost", "frames_gone", "frames_late"), (Part.BUS,)),
    **dict.fromkeys(("brake_slips", "brake_late", "brake_drags", "brake_open", "brake_closed"), (Part.BRAKE,)),
    "e_stop": (Part.E_STOP,),
    **dict.fromkeys(("rope_slips", "spring_changes"), (Part.ROPE,)),
    **dict.fromkeys(("loop_hangs", "loop_skips"), (Part.COMPUTER,)),
}  # fmt: skip
"""By the name of a drawn kind."""
