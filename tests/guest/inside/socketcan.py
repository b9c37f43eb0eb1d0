"""Runs in the guest only (see ../test_guest.py): what a real kernel's CAN interface does, without a daemon."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.config import rig_file as config
from rigctl.control.control_process import open_bus
from rigctl.devices.startup import StartupError, refuse_rival
from tests.guest.inside.guest_rig import link, rig_file


def test_a_missing_interface_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    with pytest.raises(StartupError, match=r"^socketcan:can9 cannot be opened: .*No such device.*$"):
        open_bus(config.load(rig_file(tmp_path, "can9")))


def test_an_interface_that_is_down_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    settings = config.load(rig_file(tmp_path, "vcan1"))
    link("vcan1", "down")
    refusal = r"^socketcan:vcan1 cannot be read: .* \(is the interface up\?\)$"
    with open_bus(settings) as bus, pytest.raises(StartupError, match=refusal):
        refuse_rival(bus, settings)
    link("vcan1", "up")
