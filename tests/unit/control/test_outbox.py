"""What the loop sends, on a bus that takes it or does not."""

from __future__ import annotations

import pathlib

import can
import pytest

from rigctl.config import rig_file as config
from rigctl.control.bus.outbox import Outbox
from rigctl.ipc.runtime_folder import Runtime
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")


class Refusing(can.BusABC):
    """A bus that takes frames or none."""

    def __init__(self) -> None:
        self.full = False
        super().__init__(channel="refusing")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        if self.full:
            raise can.CanOperationError("no buffer space")


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path)
    found.make_rings(SETTINGS)
    return found


def test_a_frame_that_the_bus_refuses_is_counted_and_is_no_command_of_no_speed(runtime: Runtime) -> None:
    bus, frames = Refusing(), runtime.frames.reader()
    outbox = Outbox(bus, SETTINGS, runtime.frames.writer())
    for tick in range(3):
        outbox.command(0x0F, 0.0, tick)
    assert (outbox.sent, outbox.failures, outbox.syncs, outbox.safe_frames) == (7, 0, 3, 3)  # one heartbeat
    assert len(frames.read()) == 7
    bus.full = True
    outbox.command(0x0F, 0.0, 3)
    assert (outbox.sent, outbox.failures, outbox.syncs, outbox.safe_frames) == (7, 2, 3, 3)
    assert outbox.failure_text == "no buffer space"
    assert len(frames.read()) == 0
    bus.full = False
    outbox.command(0x0F, 1.0, 4)
    assert (outbox.failures, outbox.syncs, outbox.safe_frames) == (2, 4, 0)
