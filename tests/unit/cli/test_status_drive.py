"""The drive in ``rigctl status``: its own state, and apart from it what shows that a power off has had its effect."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.cli import status
from rigctl.model.faults import Fault
from rigctl.model.states import HeldBy, Mode, PowerOff
from tests.builders.page_states import state


def rows(state: dict[str, Any]) -> dict[str, str]:
    return {label: value for label, value, _ in status.rows(state)}


@pytest.mark.parametrize(
    ("by", "shown"),
    [(HeldBy.BRAKE, "off (SWITCH ON DISABLED)"), (HeldBy.TAKING, "not off (SWITCHED ON)"),
     (HeldBy.MOTOR, "on (OPERATION ENABLED)"), (HeldBy.UNKNOWN, "not known")],
)  # fmt: skip
def test_the_drive_has_a_line_with_the_state_that_it_reports(by: HeldBy, shown: str) -> None:
    assert rows(state(Mode.HOLD, held_by=by))["drive"] == shown


@pytest.mark.parametrize("power_off", PowerOff)
def test_a_power_off_has_a_line_of_its_own_that_names_what_shows_it(power_off: PowerOff) -> None:
    more: dict[str, Any] = {"power_off": power_off.name} if power_off else {}
    found = rows(state(Mode.FAULT, fault=Fault.DRIVE_FAULT, **more))
    assert found.get("power off", "") == power_off.words
    assert found["load at rest"] == "yes, by tension and stroke"
