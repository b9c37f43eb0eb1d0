"""Measures the loop at one rate, in closed loop on the simulated rig, in turns with cyclictest."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.operated_rig import arm_and_tension
from rigctl.bench import cyclictest
from rigctl.config.settings import RigSettings
from rigctl.demo.live_rig import LiveRig, LiveRigError, own, start_live_rig
from rigctl.metrics import tension_error as metrics
from rigctl.model.states import Mode

OPERATOR = "bench"
ROUNDS = 3
TARGET_N = 60.0
"""The closed loop has the same work as at 300 N, and reaches this target in a fifth of the time."""
TENSIONED_LIMIT_S = 60.0
INCLINOMETER_HZ = 100
"""Used at other rates than the rig's own: it divides every usual rate."""
_WAIVER = "bench: the loop's timing is measured, nothing hangs there"


@dataclass(frozen=True)
class RateResult:
    """Figures of one rate; ``cyclictest`` is None if it cannot be run."""

    rate_hz: int
    loop: dict[str, Any]
    cyclictest: dict[str, Any] | None

    @property
    def period_us(self) -> float:
        """Period of one tick."""
        return 1e6 / self.rate_hz

    @property
    def lateness_p999_ratio(self) -> float | None:
        """Lateness p99.9 of the loop over cyclictest's."""
        if self.cyclictest is None:
            return None
        return float(self.loop["lateness_us"]["p999"] / max(self.cyclictest["lateness_us"]["p999"], 1.0))

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        ratio = self.lateness_p999_ratio
        more = {"cyclictest": self.cyclictest, "lateness_p999_ratio": ratio} if self.cyclictest else {}
        return {"loop": self.loop, **more}


def bench_settings(settings: RigSettings, rate_hz: int) -> RigSettings:
    """The rig's settings for a bench, with another name, port and folders.

    The simulated bus has no bit timing, so a rate is possible that overloads a real bus (4 kHz: 170 % of 1 Mbit/s). The
    design is judged at the rig's own rate.
    """

    def of(section: str, **changes: Any) -> Any:
        return getattr(settings, section).model_copy(update=changes)

    changes: dict[str, Any] = {"design": of("design", waiver=_WAIVER, gains_file=None)}
    if rate_hz != settings.loop.rate_hz:
        changes |= {"loop": of("loop", rate_hz=rate_hz), "inclinometer": of("inclinometer", rate_hz=INCLINOMETER_HZ)}
    return own(settings, "bench").model_copy(update=changes)


def measure(settings: RigSettings, rate_hz: int, seconds: float, advance: Callable[[float, str], None]) -> RateResult:
    """Measure loop and cyclictest in turns, so that both see the same conditions.

    Args:
        settings: the rig's.
        rate_hz: of the loop.
        seconds: of the loop, and as many of cyclictest.
        advance: called with the seconds passed and the current step.

    Raises:
        LiveRigError: the loop did not reach COMPENSATING, or did not stay there.
    """
    slices, rounds = [], []
    for _ in range(ROUNDS):
        slices.append(_loop(settings, rate_hz, seconds / ROUNDS))
        advance(seconds / ROUNDS, f"{rate_hz} Hz")
        priority, cpu = settings.loop.priority, settings.loop.cpu
        if other := cyclictest.measure(1_000_000 // rate_hz, seconds / ROUNDS, priority=priority, cpu=cpu):
            rounds.append(other)
        advance(seconds / ROUNDS, f"{rate_hz} Hz, cyclictest")
    return RateResult(rate_hz, figures(slices), cyclictest.together(rounds) if rounds else None)


def _loop(settings: RigSettings, rate_hz: int, seconds: float) -> Any:
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rigctl-bench-")))
        live_rig = stack.enter_context(start_live_rig(bench_settings(settings, rate_hz), folder, OPERATOR, quiet=True))
        tension(live_rig)
        return live_rig.run(seconds)


def tension(live_rig: LiveRig) -> None:
    """Take the rig to COMPENSATING.

    Raises:
        LiveRigError: the rig did not get there.
    """
    try:
        arm_and_tension(live_rig, target_n=TARGET_N, limit_s=TENSIONED_LIMIT_S)
    except TimeoutError:
        state = live_rig.state()
        raise LiveRigError(f"tensioning ended in {state['mode']}: {state.get('fault_text') or 'not in time'}") from None


def figures(slices: list[Any]) -> dict[str, Any]:
    """Percentiles over the slices of one rate."""
    records = np.concatenate(slices)
    skipped = sum(int(part["skipped"][-1] - part["skipped"][0]) for part in slices)
    missing = sum(int(part["frames_lost"][-1]) - int(part["frames_lost"][0]) for part in slices)
    return {
        "ticks": len(records),
        "skipped_ticks": skipped,
        "frames_missing": missing,
        "ticks_not_compensating": int(np.count_nonzero(records["mode"] != Mode.COMPENSATING)),
        "lateness_us": metrics.percentiles_us(records["lateness_ns"]),
        "work_us": metrics.percentiles_us(records["work_ns"]),
    }
