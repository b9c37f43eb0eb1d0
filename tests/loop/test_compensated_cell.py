"""A cell with every error of its class, commissioned as an operator does: what the shipped set takes out of a move."""

from __future__ import annotations

import numpy as np

from hil.plant.layout import MECHANISM
from hil.scenario.disturbances import rotation
from hil.scenario.kinds import OutAndBack
from hil.scenario.layered_rig import with_set
from hil.scenario.play import play
from hil.studies.compare import cell
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from tests.builders.paths import ROOT


def test_the_shipped_set_takes_a_fifth_or_more_of_the_cells_error_out_of_a_move(
    settings: RigSettings, gains: Gains
) -> None:
    """Less would not be worth its code; both have the same zero and scale from the ledger."""
    shipped = with_set(ROOT / "config/paper_rig.yaml", ROOT / "config/sets/compensated_cell.yaml")
    known = cell.commissioned(settings)
    move = OutAndBack(
        kind="out_and_back", angle_deg=1.0, speed_deg_s=2.0, acceleration_deg_s2=4.0, start_s=0.2, dwell_s=0.5
    )

    def error_n(section: RigSettings) -> float:
        rig = known.rig.model_copy(update={"compensation": section.compensation})
        run = play(
            rig, {MECHANISM: rotation(move)}, seconds=4.0, controller="loop", target_n=300.0, gains=gains,
            correction=known.correction,
        )  # fmt: skip
        assert not run.ended.tripped
        return abs(float(np.mean(run.truth["vertical_n"])) - 300.0)

    assert error_n(shipped) < 0.8 * error_n(settings)
