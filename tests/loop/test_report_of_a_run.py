"""A loop on the simulated plant, recorded and reported: the report's error is the plant's, as the cell measures it."""

from __future__ import annotations

import time

import msgspec
import numpy as np
import pytest

from hil.lockstep import lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.ipc.runtime_folder import ACTIVE
from rigctl.recorder.continuous import Continuous
from rigctl.recorder.recording import parts_of, read
from rigctl.report.findings import Findings, find
from rigctl.report.page import render

SETTLED_S, BATCH_S = 6.0, 0.5


@pytest.fixture(scope="module")
def run(
    settings: RigSettings, gains: Gains, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Findings, dict[int, float]]:
    """The report's findings, and the true vertical tension by time."""
    folder = tmp_path_factory.mktemp("report")
    kept = settings.recording.model_copy(update={"folder": str(folder), "free_mib": 1})
    settings = settings.model_copy(update={"recording": kept})
    truth: dict[int, float] = {}
    with lockstep(settings, gains, history_s=settings.telemetry.history_s) as rig:
        document = {"settings": settings.model_dump(mode="json"), "design": {"gains": msgspec.to_builtins(gains)}}
        rig.runtime.write_json(ACTIVE, document)
        recording = Continuous(rig.runtime, settings, 7, time.time_ns())
        rig.run(0.3)
        arm_and_tension(rig, limit_s=20.0)
        rig.rig.start_motion()
        for _ in range(round(SETTLED_S / BATCH_S)):
            for _ in range(round(BATCH_S * settings.loop.rate_hz)):
                rig.loop.tick()
                truth[rig.clock.now()] = rig.rig.truth.vertical_n
            recording.poll(rig.clock.now(), time.time_ns(), final=True)
        recording.close(rig.clock.now(), time.time_ns())
    (file,) = folder.glob("*.mcap")
    return find(read(*parts_of(file), frames=False)), truth


@pytest.mark.study
def test_the_error_is_the_plants_and_the_cells_noise(run: tuple[Findings, dict[int, float]]) -> None:
    found, truth = run
    assert found.verdict.passed
    assert found.settings is not None
    (figures,) = found.by_phase
    begin_ns = int(found.recording.records["t_ns"][found.phases[0].first])
    true = np.array([vertical_n for t_ns, vertical_n in truth.items() if t_ns >= begin_ns]) - 300.0
    noise_n = found.settings.tension_cell.noise_n
    expected_pct = 100.0 * float(np.hypot(np.sqrt(np.mean(true**2)), noise_n)) / 300.0
    assert figures.eta_rms_pct == pytest.approx(expected_pct, rel=0.1)
    assert figures.seconds == pytest.approx(SETTLED_S - 2.0, abs=0.1)
    assert figures.missing == 0


def test_it_says_that_the_time_was_simulated_and_what_happened(run: tuple[Findings, dict[int, float]]) -> None:
    found, _ = run
    assert found.timing.simulated
    assert [span.name for span in found.modes] == ["DISARMED", "HOLD", "TENSIONING", "COMPENSATING"]
    assert any("TENSIONING -> COMPENSATING" in event.text for event in found.events)
    assert found.bus.lost == 0
    assert found.bus.load == pytest.approx(0.4544)
    page = render(found)
    assert "Simulated time:" in page
    assert "loop bandwidth" in page
