"""Faults of the controller itself that simulated time can show; `hil.faults.processes` has the real ones."""

from __future__ import annotations

from hil.faults.stand import Injector, Stand, Step


def hangs(ticks: int) -> Injector:
    """The loop stands still for so many ticks, the rig goes on."""

    def inject(stand: Stand) -> None:
        stand.rig.clock.skip = ticks

    return inject


def overruns(ticks: int, every_s: float) -> Injector:
    """A few ticks are missed, again and again."""

    def inject(stand: Stand) -> Step:
        due = [0.0]

        def step(t_s: float) -> None:
            if t_s >= due[0]:
                due[0] += every_s
                stand.rig.clock.skip = ticks

        return step

    return inject
