"""Whether the drive's position is the stroke, from samples alone."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.load.homed import GAP_NS, Homed, LastStroke
from rigctl.model.verbs import STROKE_TOLERANCE_MM
from tests.builders.paths import ROOT

CYLINDER = config.load(ROOT / "config/paper_rig.yaml").cylinder
MS = 1_000_000


def homed() -> Homed:
    found = Homed(CYLINDER, LastStroke(50.0))
    verdict = found.look(50.0, 0.0, 0)
    assert verdict is not None
    assert verdict.believed
    return found


def test_a_jump_is_told_once_until_an_operator_confirms_the_stroke() -> None:
    subject = homed()
    verdict = subject.look(50.6, 0.0, 1 * MS)
    assert verdict is not None
    assert (verdict.believed, verdict.last_mm) == (False, 50.0)
    assert subject.look(50.0, 0.0, 2 * MS) is None
    assert (subject.known, subject.doubted, subject.jump_mm) == (False, True, pytest.approx(0.6))
    assert subject.confirm(50.0).believed
    assert (subject.known, subject.doubted, subject.jump_mm) == (True, False, 0.0)
    again = subject.look(51.0, 0.0, 3 * MS)
    assert again is not None
    assert not again.believed


@pytest.mark.parametrize("speed_mm_s", [0.0, 8.0, -8.0])
@pytest.mark.parametrize("passed_ns", [1 * MS, GAP_NS])
def test_what_the_speed_explains_is_no_jump(speed_mm_s: float, passed_ns: int) -> None:
    for beyond_mm, believed in ((STROKE_TOLERANCE_MM - 0.01, True), (STROKE_TOLERANCE_MM + 0.01, False)):
        subject = homed()
        subject.look(50.0 + speed_mm_s * 0.5e-3, speed_mm_s, 1 * MS)
        moved_mm = speed_mm_s * passed_ns * 1e-9
        stroke_mm = 50.0 + speed_mm_s * 0.5e-3 + moved_mm + beyond_mm
        subject.look(stroke_mm, speed_mm_s, 1 * MS + passed_ns)
        assert subject.doubted is not believed


def test_over_a_longer_gap_the_drive_may_have_gone_on_until_its_own_deadline() -> None:
    for stroke_mm, believed in ((50.0 + 0.79 + STROKE_TOLERANCE_MM, True), (50.0 + 0.82 + STROKE_TOLERANCE_MM, False)):
        subject = homed()
        subject.look(50.004, 8.0, 1 * MS)
        subject.look(stroke_mm, 0.0, 1 * MS + 3 * GAP_NS)  # 0.1 s at 8 mm/s
        assert subject.doubted is not believed
