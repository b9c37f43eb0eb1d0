"""Every question about the drive's power and brake, against its words over any history of states, words and ages."""

from __future__ import annotations

from typing import NamedTuple

from hypothesis import given
from hypothesis import strategies as st

from rigctl.config.settings import RigSettings
from rigctl.control.power.power_seen import PowerDetector, stopping_ns
from rigctl.devices.objects import Controlword
from rigctl.model.device_states import DriveState
from tests.builders.rig_bench import SETTINGS

MS, S = 1_000_000, 1_000_000_000
WITHOUT_POWER = {DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.FAULT}


class Stretch(NamedTuple):
    """A time in which nothing changes."""

    lasts_ms: int
    state: DriveState
    word: Controlword
    still_ms: int
    heard: bool
    current: bool


STRETCHES = st.lists(
    st.builds(
        Stretch, st.integers(1, 8000), st.sampled_from(DriveState), st.sampled_from(Controlword), st.integers(0, 8000),
        st.booleans(), st.booleans(),
    ),
    min_size=1, max_size=6,
)  # fmt: skip


def rig(brake_ms: int) -> RigSettings:
    return SETTINGS.model_copy(update={"cylinder": SETTINGS.cylinder.model_copy(update={"brake_delay_ms": brake_ms})})


@given(STRETCHES, st.sampled_from((10, 120, 400, 1000, 3000)))
def test_each_question_is_answered_by_the_time_that_it_names(stretches: list[Stretch], brake_ms: int) -> None:
    settings = rig(brake_ms)
    detector, brake_ns, stop_ns = PowerDetector(settings), brake_ms * MS, stopping_ns(settings)
    now_ns, off, cut, not_on = 5 * S, 0, 0, 0
    for n, one in enumerate(stretches):
        before = stretches[n - 1] if n else None
        for step, passed in enumerate((1 * MS, one.lasts_ms * MS)):
            now_ns += passed
            kept = before is not None or step > 0  # a condition lasts from the first look that finds it
            was = one if step else before
            off = off + passed if kept and was and {was.state, one.state} <= WITHOUT_POWER else 0
            cut = cut + passed if kept and was and all(_cuts(x.word) for x in (was, one)) else 0
            not_on = not_on + passed if kept and was and not any(_leads_on(x.word) for x in (was, one)) else 0
            detector.look(
                now_ns, one.state, one.word.value, one.still_ms * MS, heard=one.heard, current=one.current
            )  # fmt: skip
            seen = detector.seen
            assert seen.state is one.state
            assert seen.off_ns == off
            assert seen.brake_time_over == (off >= brake_ns)
            assert seen.stop_over == (off >= max(2 * S, brake_ns))
            assert seen.seated == (off >= min(brake_ns, 400 * MS))
            assert seen.first_second_over == (off > brake_ns + 1 * S)
            assert seen.settles == (off <= brake_ns + 3 * S)
            assert seen.left_alone == (off >= 2 * brake_ns + 200 * MS)
            assert seen.overdue == (off >= 2 * brake_ns)
            assert seen.stopped_and_closed == (off >= stop_ns + brake_ns)
            stopped = one.still_ms * MS >= brake_ns and off >= stop_ns + brake_ns
            closed = off >= brake_ns and not_on >= brake_ns and (stopped or cut >= brake_ns)
            assert seen.braked == (closed and one.heard and not one.current)


def _cuts(word: Controlword) -> bool:
    return word in (Controlword.DISABLE_VOLTAGE, Controlword.FAULT_RESET)


def _leads_on(word: Controlword) -> bool:
    return word in (Controlword.SWITCH_ON, Controlword.ENABLE_OPERATION)
