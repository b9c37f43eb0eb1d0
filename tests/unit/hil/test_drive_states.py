"""CiA 402 state machine, every state against every controlword, over the bus."""

from __future__ import annotations

import pytest

from hil.nodes.drive_states import command_of, next_state
from rigctl.devices.objects import Controlword
from rigctl.model.device_states import DriveState

STATES = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP_ACTIVE,
    DriveState.FAULT_REACTION_ACTIVE,
    DriveState.FAULT,
)
NONE = None
DISABLED, READY, ON = DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON
ENABLED, STOPPING = DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE

EXPECTED = {  # rows: controlword; columns: STATES; transcribed from the figure of CiA 402-2, not from the code
    Controlword.SHUTDOWN: (NONE, READY, NONE, READY, READY, NONE, NONE, NONE),
    Controlword.SWITCH_ON: (NONE, NONE, ON, ON, ON, NONE, NONE, NONE),
    Controlword.ENABLE_OPERATION: (NONE, NONE, ON, ENABLED, NONE, ENABLED, NONE, NONE),
    Controlword.DISABLE_VOLTAGE: (NONE, NONE, DISABLED, DISABLED, DISABLED, DISABLED, NONE, NONE),
    Controlword.QUICK_STOP: (NONE, NONE, DISABLED, DISABLED, STOPPING, NONE, NONE, NONE),
    Controlword.FAULT_RESET: (NONE, NONE, NONE, NONE, NONE, NONE, NONE, DISABLED),
}


@pytest.mark.parametrize("command", list(Controlword))
@pytest.mark.parametrize("column", range(len(STATES)), ids=[state.name for state in STATES])
def test_transition(command: Controlword, column: int) -> None:
    assert next_state(STATES[column], command) is EXPECTED[command][column]


def test_commands_are_told_by_the_bits_that_matter() -> None:
    """CiA 402-2, table "command coding"; x bits set as real drives receive them."""
    for controlword, command in (
        (0x0006, Controlword.SHUTDOWN),
        (0x010E, Controlword.SHUTDOWN),
        (0x0007, Controlword.SWITCH_ON),
        (0x0017, Controlword.SWITCH_ON),
        (0x000F, Controlword.ENABLE_OPERATION),
        (0x001F, Controlword.ENABLE_OPERATION),
        (0x0000, Controlword.DISABLE_VOLTAGE),
        (0x000D, Controlword.DISABLE_VOLTAGE),
        (0x0002, Controlword.QUICK_STOP),
        (0x000B, Controlword.QUICK_STOP),
    ):
        assert command_of(controlword, 0) is command, hex(controlword)


def test_a_fault_reset_is_a_rising_edge_and_nothing_else_counts_while_the_bit_stays() -> None:
    assert command_of(0x0080, 0x0000) is Controlword.FAULT_RESET
    assert command_of(0x008F, 0x000F) is Controlword.FAULT_RESET
    assert command_of(0x0080, 0x0080) is None
    assert command_of(0x008F, 0x0080) is None


def test_every_controlword_has_at_most_one_meaning() -> None:
    for controlword in range(0x10000):
        meaning = command_of(controlword, 0)
        assert meaning is None or isinstance(meaning, Controlword)
        if controlword & 0x80:
            assert meaning is Controlword.FAULT_RESET
