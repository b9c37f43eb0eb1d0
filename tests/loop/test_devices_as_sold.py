"""The loop on commercial devices: the demo on each variant, one sample in two frames, and a recording of it."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.demo.lockstep import play_lockstep
from rigctl.demo.summary import Summary
from rigctl.devices import objects as od
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.recorder.recording import parts_of, read
from rigctl.replay.compare import first_difference
from rigctl.replay.play import play, spans
from tests.builders.rig_bench import changed
from tests.unit.hil.test_parameter_sets import with_set

VARIANTS = ("no_rtr", "fixed_mapping", "increments", "slow_sdo", "slow_boot", "stock_drive", "as_sold")
SHORT = {"angle_deg": 1.0}  # out and back: every phase of the demo, in a tenth of its time
DRIVE_NODE = 4


def demo(settings: RigSettings, folder: pathlib.Path | None = None) -> Summary:
    kept = {"enabled": folder is not None, "folder": str(folder)}
    settings = changed(settings, demo=SHORT, recording=kept)
    assert settings.demo is not None
    return play_lockstep(settings, settings.demo, lambda _moment, _step: None)


@pytest.mark.parametrize(
    "variant", ["as_sold", *(pytest.param(one, marks=pytest.mark.long) for one in VARIANTS if one != "as_sold")]
)
def test_the_demo_passes_on_every_variant(variant: str) -> None:
    summary = demo(with_set(variant))
    assert summary.passed
    assert summary.frames.lost == 0


def test_a_recording_of_fixed_mappings_and_increments_replays_bit_identical(tmp_path: pathlib.Path) -> None:
    """Fixed mappings in another order, units by the drive's feed constant: the recording keeps what start-up found."""
    settings = changed(with_set("as_sold"), simulation={"devices": {"sdo_ms": 0, "boot_s": 0.0}})
    settings = changed(settings, cylinder={"increments_per_mm": None})
    summary = demo(settings, tmp_path)
    assert summary.passed and summary.recording is not None
    found = read(*parts_of(summary.recording))
    (span,) = spans(found)
    assert span.process_data.frames["tension_cell"].mapping == (0x61500108, 0x10010008, 0x91300120)
    assert span.process_data.units.position_mm == pytest.approx(1 / 209_715.2)
    same, difference = first_difference(play(found, span), lambda _done, _doing: None)
    assert difference is None and same == len(span.records) == summary.ticks


@pytest.fixture
def stock(gains: Gains) -> Iterator[Lockstep]:
    """COMPENSATING with a stock drive, which sends its speed in a frame of its own."""
    with lockstep(with_set("stock_drive"), gains) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=20.0, settle_s=0.5)
        yield rig


def drop(rig: Lockstep, can_id: int, count: int) -> None:
    """Lose the next frames of this identifier."""
    left = count

    def tap(_sender: object, frame: bytes) -> list[bytes]:
        nonlocal left
        if FRAME.unpack(frame)[0] == can_id and left:
            left -= 1
            return []
        return [frame]

    rig.hub.tap = tap


@pytest.mark.parametrize("base", [od.TPDO1_BASE, od.tpdo_base(3)])
def test_a_sample_of_two_frames_is_fresh_only_when_both_have_come(stock: Lockstep, base: int) -> None:
    inbox = stock.loop.inbox
    stock.run(0.01)
    assert inbox.drive_fresh
    drop(stock, base + DRIVE_NODE, 3)
    stock.loop.tick()  # uses the values of the previous SYNC
    before = inbox.drive.t_ns
    for _ in range(3):
        stock.loop.tick()
        assert not inbox.drive_fresh
    assert inbox.drive.t_ns == before
    stock.run(0.002)
    assert inbox.drive_fresh
    assert inbox.frames_missing() == 3
    assert stock.loop.machine.mode is Mode.COMPENSATING


@pytest.mark.parametrize("base", [od.TPDO1_BASE, od.tpdo_base(3)])
def test_a_drive_one_of_whose_frames_dies_is_stale_and_the_stroke_held(stock: Lockstep, base: int) -> None:
    drop(stock, base + DRIVE_NODE, 1 << 30)
    records = stock.run(0.1)
    assert records["mode"][-1] == Mode.FAULT
    assert Fault(int(records["fault"][-1])) is Fault.DRIVE_STALE
    before = stock.rig.truth.stroke_mm
    stock.run(1.0)
    assert stock.rig.truth.stroke_mm == pytest.approx(before, abs=0.2)
