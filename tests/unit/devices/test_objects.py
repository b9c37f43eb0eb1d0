"""Numbers that standards give, on the wire of every device: ours and the simulated ones use the same constants."""

from __future__ import annotations

from rigctl.devices import objects as od


def test_units_and_device_types_are_those_of_the_standards() -> None:
    assert od.SI_UNIT_NEWTON == 0x0021_0000  # CiA 303-2
    assert (od.DEVICE_TYPE_402 & 0xFFFF, od.DEVICE_TYPE_410 & 0xFFFF) == (402, 410)
    assert (od.DEVICE_TYPE_402 >> 16, od.DEVICE_TYPE_410 >> 16) == (0x0002, 0x0003)
    assert od.MM_S_PER_VELOCITY_16_UNIT == 0.01
