"""What the charts draw: nothing that is not trusted, and no error that is only a change of target."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.ipc.record import RECORD
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.page.chart_signals import SIGNALS, values_of
from rigctl.wire.state_words import error, on_ramp

NAMES = [signal.name for signal in SIGNALS]


def drawn(name: str, **values: float) -> float:
    record = np.zeros(1, RECORD.dtype)
    for field, value in {"mode": int(Mode.COMPENSATING), "target_n": 300.0, "setpoint_n": 300.0, "tension_n": 300.3,
                         "vertical_n": 300.3, "stroke_mm": 52.0, **values}.items():  # fmt: skip
        record[field] = value
    return float(values_of(record)[0, NAMES.index(name)])


def test_the_error_is_that_against_the_set_point() -> None:
    assert drawn("error_pct") == pytest.approx(0.1)
    assert drawn("error_pct", target_n=310.0) == pytest.approx(100 * 0.3 / 310)  # on its ramp; seen: -3 %
    leaning = {"tension_n": 300.0, "setpoint_n": 300.0, "vertical_n": 299.0, "target_n": 299.0}
    assert drawn("error_pct", **leaning) == pytest.approx(0.0)


@pytest.mark.parametrize(("fault", "gone", "left"), [
    (Fault.CELL_STUCK, "vertical_n", "stroke_mm"),
    (Fault.ENCODER_STUCK, "stroke_mm", "vertical_n"),
])  # fmt: skip
def test_a_value_in_doubt_is_no_trace(fault: Fault, gone: str, left: str) -> None:
    """A stuck cell's samples are fresh and valid: its trace was drawn on."""
    assert np.isnan(drawn(gone, cause_bits=fault.bit))
    assert np.isfinite(drawn(left, cause_bits=fault.bit))


def test_the_words_say_that_a_new_target_is_on_its_way() -> None:
    state = {"mode": "COMPENSATING", "loop_alive": True, "target_n": 310.0, "setpoint_n": 301.0, "tension_n": 301.0,
             "vertical_n": 301.0, "error_n": -9.0, "error_pct": 3.0, "quality": {}}  # fmt: skip
    assert on_ramp(state)
    assert error(state) == "- (on the way to 310.0 N)"
    assert not on_ramp(state | {"setpoint_n": 310.0})
    assert "on the way" not in error(state | {"setpoint_n": 310.0})
