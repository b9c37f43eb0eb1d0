"""Records of an excitation are kept beyond the ring, and evaluated in a process of its own."""

from __future__ import annotations

import math
import pathlib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation import frequency_trial
from rigctl.control.law.tension import Gains
from rigctl.gateway.evaluation_process import evaluate
from rigctl.gateway.excited_records import FIELDS, ExcitedRecords
from rigctl.ipc.record import RECORD
from rigctl.ipc.ring import RingWriter
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.model.states import Mode
from rigctl.operations.evaluation import EvaluationError, law_response
from tests.builders.linear_plant import TruePlant, true_sensitivities
from tests.builders.paths import ROOT
from tests.builders.synthetic_response import PLANT, TICK_S
from tests.builders.synthetic_response import records as made_records

PAPER = config.load(ROOT / "config/paper_rig.yaml")
GAINS = {"k_tension": 1.33912, "k_speed": 0.148812, "k_integral": 1.02972}


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    made = Runtime(tmp_path)
    made.make_rings(PAPER)
    return made


def configure(runtime: Runtime, settings: RigSettings = PAPER) -> None:
    active = {"settings": settings.model_dump(mode="json"), "design": {"gains": GAINS}, "run_id": "x"}
    runtime.write_json(ACTIVE, active)


def write(writer: RingWriter, first: int, count: int, excitation_mm_s: float) -> None:
    """Ticks 1 ms apart."""
    names = RECORD.dtype.names[1:]  # type: ignore[index]
    values = list(np.zeros(1, RECORD.dtype)[0].item()[1:])
    values[names.index("excitation_mm_s")] = excitation_mm_s
    for tick in range(first, first + count):
        values[names.index("t_ns")] = tick
        writer.write(*values)


def test_records_of_an_excitation_are_kept_from_its_start(runtime: Runtime) -> None:
    kept, writer = ExcitedRecords(runtime, 1000), runtime.records.writer()
    write(writer, 1, 500, 0.0)
    kept.poll()
    assert len(kept.between(0, 10**6)) == 500  # the poll before may hold the first excited tick's sample
    for part in range(30):
        write(writer, 501 + 500 * part, 500, 1.0)
        kept.poll()
    found = kept.between(100, 15_400)
    assert (found["t_ns"] == np.arange(101, 15_401)).all()
    assert (np.diff(found["seq"].astype(int)) == 1).all()
    for part in range(3):
        write(writer, 15_501 + 500 * part, 500, 0.0)
        kept.poll()
    assert len(kept.between(0, 10**6)) <= 500


def test_no_more_is_kept_than_a_measurement_needs(runtime: Runtime) -> None:
    kept, writer = ExcitedRecords(runtime, 10), runtime.records.writer()
    for part in range(20):
        write(writer, 1 + 100 * part, 100, 1.0)
        kept.poll()
    assert len(kept.between(0, 10**6)) == 1200


def excited(plant: TruePlant = PLANT) -> npt.NDArray[Any]:
    """As the ring's reader gives them, of a trial in HOLD on a linear plant."""
    signal = frequency_trial.signal(PAPER, regulated=False)
    periods = frequency_trial.PERIODS + 2
    source = made_records(plant, periods=periods, signal=signal)
    _, after = frequency_trial.measured_ticks(PAPER)
    ended = np.concatenate([source, np.repeat(source[-1:], after)])
    found = np.zeros(len(ended), [(name, RECORD.dtype[name]) for name in FIELDS])
    for name in FIELDS:
        found[name] = ended[name]
    found["seq"], found["mode"] = np.arange(1, len(found) + 1), Mode.HOLD
    return found


def test_records_are_evaluated_in_a_process_of_its_own(runtime: Runtime) -> None:
    configure(runtime)
    answer = evaluate(runtime, "response", excited())
    plant = answer["figures"]["plant"]
    assert plant["stiffness_n_mm"]["value"] == pytest.approx(PLANT.stiffness, rel=0.01)
    assert plant["lag_s"]["value"] == pytest.approx(PLANT.lag, rel=0.01)
    assert answer["figures"]["mode"] == "HOLD"
    acting, hz = law_response(PAPER, Gains(**GAINS)), np.geomspace(0.5, 300.0, 2000)
    at_input, _ = true_sensitivities(PLANT, *acting(hz), hz)
    assert answer["figures"]["margins"]["ms_input"]["value"] == pytest.approx(np.abs(at_input).max(), abs=0.03)
    assert answer["before"]["stiffness_n_mm"] == pytest.approx(PAPER.plant.stiffness_n_mm)
    assert math.isclose(answer["figures"]["tick_s"], TICK_S)


def test_what_cannot_be_evaluated_is_one_line(runtime: Runtime) -> None:
    with pytest.raises(EvaluationError, match=r"active\.json holds no valid settings"):
        evaluate(runtime, "response", excited())
    configure(runtime)
    with pytest.raises(EvaluationError, match="not there any more"):
        evaluate(runtime, "response", excited()[:0])
    with pytest.raises(EvaluationError, match="records of the measurement are missing"):
        evaluate(runtime, "response", np.delete(excited(), 30_000))
    still = excited()
    still["excitation_mm_s"] = still["command_mm_s"] = 0.0
    with pytest.raises(EvaluationError, match="the records show no excitation"):
        evaluate(runtime, "response", still)
