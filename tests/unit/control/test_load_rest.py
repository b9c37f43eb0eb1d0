"""What shows a load at rest, from one snapshot after another."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.findings import HeldTensionSeen
from rigctl.control.load.load_at_rest import BOUNCE_NS, REST_NS, STILL_MM, LoadRest
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault, bits_of
from rigctl.model.states import LoadAtRest
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
STEP_NS = 10_000_000
FALL_N = 2.0 * STILL_MM * PAPER.plant.stiffness_n_mm


class Load:
    """On the closed brake, at rest by tension and stroke since ``REST_NS``."""

    def __init__(self) -> None:
        self._rest, self._t_ns = LoadRest(PAPER), 0
        assert self.look(REST_NS + STEP_NS) is LoadAtRest.BOTH

    def look(self, time_ns: int, *, sinks_n: float = 0.0, causes: int = 0, tension_n: float = 300.0) -> LoadAtRest:
        """What it shows after this time."""
        for _ in range(time_ns // STEP_NS):
            self._t_ns += STEP_NS
            snapshot = Snapshot(
                t_ns=self._t_ns,
                tension_n=tension_n,
                held_tension=HeldTensionSeen(sinks_n=sinks_n),
                still_ns=REST_NS,
                cell_heard=True,
                drive_heard=True,
            )
            shown = self._rest.look(causes, snapshot)
        return shown


def test_a_fall_that_ends_as_that_of_a_bounce_is_no_motion() -> None:
    load = Load()
    for _ in range(3):
        assert load.look(BOUNCE_NS - STEP_NS, sinks_n=FALL_N) is LoadAtRest.BOTH
        assert load.look(STEP_NS) is LoadAtRest.BOTH
    assert load.look(BOUNCE_NS, sinks_n=FALL_N) is LoadAtRest.MOVES


@pytest.mark.parametrize(
    ("causes", "shown"),
    [((Fault.DRIVE_STALE, Fault.CELL_STUCK), LoadAtRest.STROKE),
     ((Fault.E_STOP, Fault.ENCODER_STUCK), LoadAtRest.TENSION),
     ((Fault.CELL_STUCK, Fault.ENCODER_STUCK), LoadAtRest.UNKNOWN),
     ((Fault.CELL_STALE, Fault.CELL_INVALID), LoadAtRest.BOTH)],  # of a cell that is well again
)  # fmt: skip
def test_a_cause_that_doubts_a_witness_leaves_the_other(causes: tuple[Fault, ...], shown: LoadAtRest) -> None:
    assert Load().look(STEP_NS, causes=bits_of(causes)) is shown


def test_a_tension_that_moved_shows_no_rest_once_it_is_in_doubt_or_slack() -> None:
    """It moved until now, and the stroke alone, at rest all along, would show a load at rest at once."""
    for then_n, causes in ((300.0, Fault.STRETCH_UNEXPLAINED.bit), (0.0, 0)):
        load = Load()
        for step in range(100):
            assert load.look(STEP_NS, tension_n=310.0 + step) is not LoadAtRest.STROKE
        assert load.look(REST_NS - STEP_NS, causes=causes, tension_n=then_n) is LoadAtRest.MOVES
        assert load.look(2 * REST_NS, causes=causes, tension_n=then_n) is LoadAtRest.STROKE
