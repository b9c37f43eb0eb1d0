"""A rail encoder on the bus, and the run-out table learnt from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from hil.scenario.case import load
from hil.scenario.layered_rig import with_set
from hil.scenario.play import play
from hil.wire import FRAME
from rigctl.config.rail_sections import RunOutSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices import busload, objects, startup
from rigctl.model.faults import Fault
from rigctl.model.samples import Quality
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_changes import change_run_out
from tests.builders.paths import ROOT
from tests.builders.rig_bench import changed

SHIPPED = with_set(ROOT / "config/paper_rig.yaml", ROOT / "config/sets/rail_encoder.yaml")
assert SHIPPED.rail_encoder is not None and SHIPPED.run_out is not None
ENCODER, TABLE = SHIPPED.rail_encoder, SHIPPED.run_out
NODE = ENCODER.node


def fitted(settings: RigSettings, table: RunOutSettings | None = TABLE, **encoder: Any) -> RigSettings:
    update = {"rail_encoder": ENCODER.model_copy(update=encoder), "run_out": table}
    return settings.model_copy(update=update)


def test_the_error_on_an_uneven_rail_shrinks_from_move_to_move(settings: RigSettings, gains: Gains) -> None:
    """With the shipped set in the shipped scenario; it has to take a fifth away to be worth its code."""
    case = load(ROOT / "config/scenarios/uneven_rail.yaml")

    def rms_by_move(rig: RigSettings) -> list[float]:
        run = play(rig, case.tracks, seconds=case.scenario.duration_s, controller="loop", target_n=300.0, gains=gains)
        assert not run.ended.tripped
        error = run.truth["vertical_n"] - 300.0
        spans = [case.scenario.windows[name] for name in ("first_move", "last_move")]
        within = [(run.t_s >= span.from_s) & (run.t_s <= span.to_s) for span in spans]
        return [float(np.sqrt(np.mean(error[inside] ** 2))) for inside in within]

    without, learning = rms_by_move(settings), rms_by_move(case.settings)
    assert learning[0] == pytest.approx(without[0], rel=0.02)  # the table is empty on the first move
    assert learning[1] < 0.6 * learning[0]
    assert learning[1] < 0.7 * without[1]


def test_an_encoder_alone_changes_no_command(settings: RigSettings, gains: Gains) -> None:
    def commands(rig_settings: RigSettings) -> list[bytes]:
        with lockstep(rig_settings, gains, log=True) as rig:
            begun_ns = rig.clock.now()
            rig.run(0.2)
            assert rig.command(Verb.ARM) is Refusal.NONE
            while rig.clock.now() < begun_ns + 2_000_000_000:  # an encoder is read back too
                rig.loop.tick()
            before = len(rig.frames)
            assert rig.command(Verb.TENSION) is Refusal.NONE
            rig.run_until(Mode.COMPENSATING, 10.0)
            rig.rig.start_motion()
            rig.run(1.0)
            frames = [FRAME.unpack(frame) for _, frame in rig.frames[before:]]
        return [data for can_id, _, data in frames if can_id == objects.RPDO1_BASE + settings.cylinder.node]

    bare, encoder, empty = (commands(s) for s in (settings, fitted(settings, table=None), fitted(settings)))
    assert bare == encoder == empty  # an empty table has no effect, on the first way


def test_records_show_the_rails_angle_and_no_frame_is_missed(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, rate_hz=100), gains) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=12.0)
        rig.rig.start_motion()
        records = rig.run(6.0)
        assert rig.report.devices[2].name == "rail encoder"
        assert records["rail_rad"][-1] == pytest.approx(rig.rig.truth.rail_rad, abs=1e-3)  # one sample old
    assert records["rail_rad"][-1] != 0.0
    assert not records["rail_quality"].any()
    assert not records["frames_lost"].any()


def test_without_an_encoder_the_record_says_so(rig: Lockstep) -> None:
    records = rig.run(0.1)
    assert (records["rail_quality"] & Quality.NEVER).all()
    assert not records["rail_rad"].any()
    assert not records["run_out_mm_s"].any()


def test_a_lost_encoder_ends_the_feed_forward_and_nothing_else(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings), gains) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=12.0)
        change_run_out(rig, [5.0] * TABLE.bins)
        assert rig.rig.start_motion()
        assert np.abs(rig.run(6.0)["run_out_mm_s"]).max() > 0.01

        encoder = rig.rig.rail_encoder
        assert encoder is not None
        encoder.raise_error(objects.EmcyCode.SENSOR_INVALID, 0x81)
        records = rig.run(0.5)[5:]
        assert (records["rail_quality"] == Quality.INVALID).all()
        assert not records["run_out_mm_s"].any()
        encoder.clear_error(objects.EmcyCode.SENSOR_INVALID)
        assert not rig.run(0.5)["rail_quality"][-1]

        rig.rig.receive(FRAME.pack(objects.NMT_COB, 2, bytes([0x02, NODE])))  # not by the bus: a rival would trip
        records = rig.run(0.5)[10:]
        assert (records["rail_quality"] == Quality.STALE).all()
        assert not records["run_out_mm_s"].any()

        rig.rig.receive(FRAME.pack(objects.NMT_COB, 2, bytes([0x81, NODE])))  # it returns with an unverified scale
        rig.rig.receive(FRAME.pack(objects.NMT_COB, 2, bytes([0x01, NODE])))
        records = rig.run(0.5)[10:]
        assert (records["rail_quality"] == Quality.INVALID).all()
        assert rig.loop.machine.mode is Mode.COMPENSATING
        assert rig.loop.machine.fault is Fault.NONE
        assert not rig.loop.inbox.network.restarted


def test_an_encoder_that_counts_otherwise_ends_the_start(settings: RigSettings, gains: Gains) -> None:
    with (
        pytest.raises(startup.StartupError, match=r"rail encoder \(node 5\), object 0x6001:00: found 0x100000"),
        lockstep(fitted(settings, counts_per_turn=4096), gains),
    ):
        pass


def test_the_bus_load_counts_the_encoder(settings: RigSettings) -> None:
    on_wire = changed(settings, can={"bitrate_bit_s": 1_000_000})
    before, after = (busload.bus_load(s) for s in (on_wire, fitted(on_wire)))
    assert before is not None
    assert after == pytest.approx(before + (95 * 1000 + 65 * 10) / 1e6, abs=2e-4)  # 4 bytes, and a heartbeat
