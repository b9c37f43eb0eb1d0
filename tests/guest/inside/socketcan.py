"""Runs in the guest only (see ../test_guest.py): what a real kernel's CAN interface does, without a daemon."""

from __future__ import annotations

import errno
import pathlib
import time
from collections.abc import Iterator

import can
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.control_process import open_bus, receive_filters
from rigctl.devices import objects as od
from rigctl.devices.process_data import wanted
from rigctl.devices.startup import StartupError, refuse_rival
from rigctl.devices.startup_bus import StartupBus
from rigctl.model.device_states import NmtState
from tests.builders.waiting import patience_s
from tests.guest.inside.guest_rig import BUS, Cable, link, rig_file

ERROR_PASSIVE = "sp000130"
FOREIGN_ID = 0x7A0


@pytest.fixture
def cable() -> Iterator[Cable]:
    """A serial adapter between the kernel's slcan driver and `BUS`."""
    adapter = Cable()
    yield adapter
    adapter.unplug()


def settings_on(folder: pathlib.Path, interface: str) -> RigSettings:
    return config.load(rig_file(folder, interface))


def heartbeat(settings: RigSettings) -> can.Message:
    """A frame that the loop reads."""
    cob = od.HEARTBEAT_BASE + settings.cylinder.node
    return can.Message(arbitration_id=cob, data=[NmtState.OPERATIONAL], is_extended_id=False)


def test_a_missing_interface_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    with pytest.raises(StartupError, match=r"^socketcan:can9 cannot be opened: .*No such device.*$"):
        open_bus(settings_on(tmp_path, "can9"))


def test_an_interface_that_is_down_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    settings = settings_on(tmp_path, "vcan1")
    link("vcan1", "down")
    refusal = r"^socketcan:vcan1 cannot be read: .* \(is the interface up\?\)$"
    with open_bus(settings) as bus, pytest.raises(StartupError, match=refusal):
        refuse_rival(StartupBus(bus, time.monotonic_ns), settings)
    link("vcan1", "up")


def test_the_kernel_keeps_frames_of_other_identifiers_from_the_loop(tmp_path: pathlib.Path) -> None:
    settings = settings_on(tmp_path, BUS)
    with open_bus(settings) as bus, can.Bus(interface="socketcan", channel=BUS) as device:
        bus.set_filters(receive_filters(settings, wanted(settings)))
        for extended in (False, True):
            device.send(can.Message(arbitration_id=FOREIGN_ID, is_extended_id=extended))
        device.send(heartbeat(settings))
        received = bus.recv(patience_s())
        assert received is not None
        assert received.arbitration_id == od.HEARTBEAT_BASE + settings.cylinder.node
        assert bus.recv(0) is None


def test_error_frames_of_the_controller_pass_the_loops_filters(tmp_path: pathlib.Path, cable: Cable) -> None:
    settings = settings_on(tmp_path, cable.interface)
    with open_bus(settings) as bus:
        bus.set_filters(receive_filters(settings, wanted(settings)))
        cable.order(f"say {ERROR_PASSIVE}")
        received = bus.recv(patience_s())
        assert received is not None
        assert received.is_error_frame
        assert received.data[1] & 0x30, "receive or transmit error passive, linux/can/error.h"


def test_a_full_queue_refuses_a_frame_at_once_and_takes_frames_when_it_is_read(
    tmp_path: pathlib.Path, cable: Cable
) -> None:
    settings = settings_on(tmp_path, cable.interface)
    with open_bus(settings) as bus, can.Bus(interface="socketcan", channel=BUS) as device:
        cable.order("stall")
        with pytest.raises(can.CanOperationError) as refused:
            for _ in range(10_000):  # the queue holds 10, the serial line some hundred
                bus.send(heartbeat(settings), timeout=0)
        assert refused.value.error_code == errno.ENOBUFS
        cable.order("resume")
        assert device.recv(patience_s()) is not None
