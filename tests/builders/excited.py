"""A lockstep rig whose frequency response is measured, with the records of all of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

LIMIT_S = 120.0
SETTLE_S = 3.0  # a soft mechanism bounces after the preload, and the sign check would see that


def built(
    settings: RigSettings,
    *,
    stiffness: float | None = None,
    mechanism: float | None = None,
    lag_scale: float = 1.0,
    delay_scale: float = 1.0,
    seed: int = 1,
    **simulation: Any,
) -> RigSettings:
    """The rig as built otherwise than its file says: stiffness and mechanism in N/mm, the latter None for rigid."""
    found = settings.simulation
    assert found is not None
    scale = 1.0 if stiffness is None else stiffness / settings.plant.stiffness_n_mm
    update = {
        "seed": seed,
        "stiffness_scale": scale,
        "lag_scale": lag_scale,
        "delay_scale": delay_scale,
        "mechanism": found.mechanism.model_copy(update={"vertical_n_mm": mechanism}),
        **simulation,
    }
    return settings.model_copy(update={"simulation": found.model_copy(update=update)})


@contextlib.contextmanager
def tensioned(
    settings: RigSettings, gains: Gains, mode: Mode, tension_n: float = 300.0, *, preload: bool = True
) -> Iterator[Lockstep]:
    """A rig in HOLD at this tension or COMPENSATING, settled; without ``preload`` it tensions a slack rope."""
    with lockstep(settings, gains) as rig:
        if preload:
            rig.rig.plant.preload(tension_n)
        rig.run(0.3)
        if mode is Mode.COMPENSATING:
            arm_and_tension(rig, armed_s=SETTLE_S, limit_s=30.0, settle_s=3.0)
        else:
            rig.do(Verb.ARM)
            rig.run(SETTLE_S)
        yield rig


def respond(rig: Lockstep) -> tuple[Refusal, npt.NDArray[Any]]:
    """Measure the response; the trial's answer, and its records."""
    rig.read_records()
    given = rig.give(Verb.RESPONSE, float("nan"))
    parts = []
    for _ in range(round(LIMIT_S / 0.5)):
        parts.append(rig.run(0.5))
        if (reply := rig.reply_to(given)) is not None:
            records = np.concatenate(parts)
            return Refusal(int(reply["reason"])), records[records["t_ns"] <= reply["t_ns"]]
    raise TimeoutError
