"""Runs in the guest only: what a CAN bus does at its worst, by the kernel's own driver, while the load hangs on it.

After each fault the load hangs where it hung; the operator's commands bring the same daemon back, once the cause is
gone, unless the interface itself has vanished.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator

import pytest

from rigctl.model.device_states import DriveState
from tests.builders.waiting import until
from tests.guest.inside.guest_rig import TARGET_N, Cable, GuestRig, controller, link, patient

TRIES = 5
LATE_S = 1.2  # a trip that a fault has begun would come within the limit of 0.8 s, and its record within 0.1
MOVED_MM = 1.0
CARRIED = 0.03


@pytest.fixture(autouse=True)
def mended(rig: GuestRig) -> Iterator[None]:
    """A test that fails leaves no fault behind."""
    yield
    rig.cable.order("resume")
    link(rig.cable.interface, "up")


def carried(rig: GuestRig, stroke_mm: float) -> None:
    assert rig.truth.stroke_mm == pytest.approx(stroke_mm, abs=MOVED_MM)
    assert rig.truth.vertical_n == pytest.approx(TARGET_N, rel=CARRIED)


def fallen(rig: GuestRig, stroke_mm: float, after: int, *faults: str) -> None:
    """FAULT, for one of ``faults`` or for what a silent bus shows first; the load carried, the drive off by itself."""
    faults = (*faults, "NODE_NOT_OPERATIONAL", "STATUS_STALE", "SUPERVISION_LOST")
    rig.until("FAULT")
    assert rig.state["fault"] in faults, rig.said
    until(lambda: re.search(rf"trip ({'|'.join(faults)}): ", rig.said[after:]), log=rig.log)
    until(lambda: rig.truth.drive is not DriveState.OPERATION_ENABLED, log=rig.log)
    carried(rig, stroke_mm)


def refused(rig: GuestRig, cause: str, after: int) -> str:
    """What a reset is told while the cause is there, once it is told to stand."""
    until(lambda: re.search(rf"(trip {cause}: |{cause} is active)", rig.said[after:]), log=rig.log)
    answer = patient(lambda: rig.command("reset"))
    assert not answer["accepted"]
    assert answer["reason"] == "cause_present"
    return str(answer["text"])


def ridden_through(rig: GuestRig, play: Callable[[], None]) -> None:
    """Play a fault while COMPENSATING: nothing trips. Where the host starved the guest meanwhile, once more."""
    for _ in range(TRIES):
        stroke_mm, after = rig.compensate(), len(rig.said)
        play()
        time.sleep(LATE_S)
        if rig.mode == "COMPENSATING":
            carried(rig, stroke_mm)
            return
        assert rig.starved_by_host(after), rig.said
    raise AssertionError(f"the host starved the guest {TRIES} times\n{rig.said}")


def test_an_error_passive_controller_is_told_in_words_and_ridden_through(rig: GuestRig) -> None:
    def play() -> None:
        after, before = len(rig.said), rig.state["error_frames"]
        for words, state, event in (
            ("sw100000", "ERROR-WARNING", "error warning, receiving"),
            ("sp000130", "ERROR-PASSIVE", "error-passive, transmitting"),
            ("e1a", "ERROR-PASSIVE", "no acknowledgement"),
            ("e2cs", "ERROR-PASSIVE", "stuff error"),
            ("sa000010", "ERROR-ACTIVE", "error-active again"),
        ):
            rig.cable.order(f"say {words}")
            rig.until_said(event, after)
            assert controller(rig.cable.interface)["state"] == state
        until(lambda: rig.state["error_frames"] == before + 5)

    ridden_through(rig, play)


def test_an_overrun_is_told_in_words_and_ridden_through(rig: GuestRig) -> None:
    def play() -> None:
        after, lost = len(rig.said), rig.state["frames_lost"]
        rig.cable.order("lose 5")
        rig.cable.order("say e1o")
        rig.until_said("receive overrun, frames lost", after)
        until(lambda: rig.state["frames_lost"] > lost)  # some may have been heartbeats, which nobody counts

    ridden_through(rig, play)


def test_a_short_babble_is_ridden_through(rig: GuestRig) -> None:
    def play() -> None:
        unsent = rig.state["send_failures"]
        rig.cable.order("babble 0.3")
        until(lambda: rig.state["send_failures"] > unsent)
        until(lambda: rig.state["tension_age_ns"] < 100_000_000)

    ridden_through(rig, play)


def test_an_interface_that_flaps_is_ridden_through(rig: GuestRig) -> None:
    def play() -> None:
        after = len(rig.said)
        link(rig.cable.interface, "down")
        link(rig.cable.interface, "up")
        rig.until_said("bus not readable: Error receiving: Network is down", after)
        until(lambda: rig.state["tension_age_ns"] < 100_000_000)

    ridden_through(rig, play)


def test_a_babbling_node_that_goes_on_is_a_silent_bus_to_us(rig: GuestRig) -> None:
    stroke_mm, after = rig.compensate(), len(rig.said)
    rig.cable.order("babble 4")
    fallen(rig, stroke_mm, after, "BUS_SILENT")
    rig.until_said("frame not sent: Failed to transmit: No buffer space available", after)
    rig.compensate()
    carried(rig, stroke_mm)


def test_an_adapter_that_takes_nothing_is_told_as_no_buffer_space(rig: GuestRig) -> None:
    stroke_mm, after, unsent = rig.compensate(), len(rig.said), rig.state["send_failures"]
    rig.cable.order("stall")
    fallen(rig, stroke_mm, after, "DRIVE_STALE", "CELL_STALE")
    rig.until_said("frame not sent: Failed to transmit: No buffer space available", after)
    assert rig.state["send_failures"] > unsent
    assert "CELL_STALE" in refused(rig, "CELL_STALE", after)
    rig.cable.order("resume")
    rig.compensate()
    carried(rig, stroke_mm)


def test_bus_off_is_told_in_words_and_over_when_the_interface_was_down_and_up(rig: GuestRig) -> None:
    stroke_mm, after = rig.compensate(), len(rig.said)
    rig.cable.order("say sb000256")
    rig.cable.order("off")
    fallen(rig, stroke_mm, after, "BUS_SILENT")
    rig.until_said("CAN error frame: bus-off", after)
    assert controller(rig.cable.interface)["state"] == "BUS-OFF"
    assert "BUS_SILENT" in refused(rig, "BUS_SILENT", after)
    link(rig.cable.interface, "down")
    link(rig.cable.interface, "up")
    rig.compensate()
    carried(rig, stroke_mm)


def test_an_interface_pulled_down_is_held_and_recovers_when_it_is_up(rig: GuestRig) -> None:
    stroke_mm, after = rig.compensate(), len(rig.said)
    link(rig.cable.interface, "down")
    fallen(rig, stroke_mm, after, "BUS_SILENT")
    rig.until_said("frame not sent: Failed to transmit: Network is down", after)
    assert "BUS_SILENT" in refused(rig, "BUS_SILENT", after)
    link(rig.cable.interface, "up")
    rig.compensate()
    carried(rig, stroke_mm)


def test_an_unplugged_adapter_needs_the_daemon_anew_and_the_refusal_says_so(rig: GuestRig) -> None:
    stroke_mm, after, name = rig.compensate(), len(rig.said), rig.cable.interface
    rig.cable.unplug()
    fallen(rig, stroke_mm, after, "BUS_SILENT")
    rig.cable = Cable()
    rig.until_said("bus not readable: Error receiving: No such device", after)
    assert rig.cable.interface == name
    assert "a CAN interface that was unplugged needs the daemon started anew" in refused(rig, "BUS_SILENT", after)
    rig.restart()
    rig.until("DISARMED")
    carried(rig, stroke_mm)
    rig.carried_out("target", TARGET_N)
    rig.compensate()
    carried(rig, stroke_mm)
