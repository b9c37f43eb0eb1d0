"""The plant alone on one core: simulated time over wall time at 0.1 ms steps, in the paper's move."""

from __future__ import annotations

import math
import time

from hil.plant import Plant
from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back
from rigctl.config import rig_file as config
from tests.builders import daemons

STEP_US = 100
SECONDS = 20.0
ROUNDS = 3
_MS = 1_000_000


def measure() -> dict[str, float]:
    """Best of three: advanced by the second, and by the millisecond with the truth read each time."""
    return {
        "free_x": max(_speed(1000) for _ in range(ROUNDS)),
        "truth_each_ms_x": max(_speed(1) for _ in range(ROUNDS)),
    }


def _speed(every_ms: int) -> float:
    settings = config.load(daemons.PAPER)
    assert settings.simulation is not None
    simulation = settings.simulation.model_copy(update={"step_us": STEP_US})
    plant = Plant(settings.model_copy(update={"simulation": simulation}), 0)
    plant.preload(settings.tension.target_n)
    plant.start_motion({MECHANISM: out_and_back(math.radians(13.0), math.radians(0.5), math.radians(0.25))}, 0)
    plant.advance(_MS)
    assert plant.truth.tension_n > 0.0  # compiles the plant
    start = time.perf_counter()
    for ms in range(every_ms, round(SECONDS * 1000) + 1, every_ms):
        plant.advance(ms * _MS)
        assert plant.truth.moving
    return SECONDS / (time.perf_counter() - start)
