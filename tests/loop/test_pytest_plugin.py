"""The pytest plugin in a fresh pytest of a fresh folder, as its user has it."""

from __future__ import annotations

import json
import pathlib
import re

import pytest

from tests.builders import daemons
from tests.builders.paths import ROOT

pytest_plugins = "pytester"
PAGE = (ROOT / "docs/hil-tests.md").read_text()
LOADED = "import json, sys, pathlib\n"


def shown(kind: str) -> list[str]:
    blocks = re.findall(rf"^```python {kind}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    return [block for block in blocks if "hil_" in block]


@pytest.mark.study
def test_what_the_page_shows_passes(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(**{f"test_shown_{number}": text for number, text in enumerate(shown("test"))})
    assert pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider").ret == 0
    assert not (pytester.path / "results").exists()


def test_the_page_begins_with_a_test_of_eight_lines() -> None:
    assert len(shown("test")) == 5
    assert len(shown("live")) == 1
    assert len(shown("test")[0].splitlines()) <= 8


@pytest.mark.real_time
@pytest.mark.alone
def test_what_the_page_shows_in_real_time_passes(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_shown=shown("live")[0])
    assert pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider").ret == 0


TRIPS = """
def test_trips({rig}):
    {rig}.do("arm")
    {rig}.inject("cell_silent", for_s=0.05)
    assert {rig}.run(0.5).mode == "HOLD"
"""


def report_and_replay(recording: pathlib.Path, folder: pathlib.Path) -> None:
    """What the page promises of a recording kept: both commands read it, and the replay is the same to the bit."""
    reported = daemons.rigctl("report", str(recording), "--output", str(folder / "report.html"))
    assert reported.returncode in (0, 1), reported.stderr  # 1: the rig has tripped, which the report judges
    assert "CELL_STALE" in (folder / "report.html").read_text()
    replayed = daemons.rigctl("replay", str(recording), "--json")
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    found = json.loads(replayed.stdout)
    assert found["identical"]
    assert sum(row["same"] for row in found["loops"]) > 500  # ticks of the last half second at least


@pytest.mark.study
def test_a_failed_test_keeps_its_picture_and_its_recording(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(TRIPS.format(rig="hil_rig"))
    done = pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider", "-o", "hil_results=kept")
    done.assert_outcomes(failed=1)
    done.stdout.re_match_lines([r"FAULT, fault CELL_STALE, at [\d.]+ s", r"kept: .*run\.png", r"kept: .*\.mcap"])
    (folder,) = (pytester.path / "kept").iterdir()
    (picture,), (recording,) = folder.glob("*.png"), folder.glob("*.mcap")
    assert picture.read_bytes().startswith(b"\x89PNG")
    from rigctl.recorder.recording import read

    records = read(recording).records
    assert records["mode"][-1] == 5 or records["fault"][-1] != 0
    assert len(records) > 700  # 0.2 s of waking, the arming, 0.5 s
    report_and_replay(recording, pytester.path)


@pytest.mark.real_time
@pytest.mark.alone
def test_a_failed_test_in_real_time_keeps_them_too(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(TRIPS.format(rig="hil_live_rig"))
    done = pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider")
    done.assert_outcomes(failed=1)
    done.stdout.re_match_lines([r"FAULT, fault CELL_STALE, at [\d.]+ s", r"kept: .*run\.png", r"kept: .*\.mcap"])
    (folder,) = (pytester.path / "results/hil").iterdir()
    (picture,), (recording,) = folder.glob("*.png"), folder.glob("*.mcap")
    assert picture.read_bytes().startswith(b"\x89PNG")
    report_and_replay(recording, pytester.path)


@pytest.mark.study
def test_a_failed_assertion_is_followed_by_few_words_about_the_stretch(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(hil_rig):\n    assert hil_rig.run(0.1).figure('skipped') == 7.0\n")
    done = pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider")
    done.stdout.fnmatch_lines(["*<RunStretch: 100 records, DISARMED, fault NONE at its end>*"])
    assert "RigSettings(" not in done.stdout.str()


@pytest.mark.study
def test_a_second_disturbance_leaves_the_first_one_going(pytester: pytest.Pytester) -> None:
    """The mechanism has turned by 1 deg when the heave begins, and stays there; the jolt comes on top of the heave."""
    pytester.makepyfile(
        """
        import math
        import pytest

        def test_it(hil_rig):
            hil_rig.disturb(mechanism=[
                {"kind": "rotate", "angle_deg": 1.0, "speed_deg_s": 1.0, "acceleration_deg_s2": 4.0}])
            hil_rig.run(2.0)
            hil_rig.disturb(vertical=[{"kind": "move", "up_mm": 2.0, "speed_mm_s": 4.0, "acceleration_mm_s2": 40.0}])
            turned = hil_rig.run(1.0).truth
            hil_rig.disturb(impacts=[{"kind": "step", "height_mm": 0.5, "rise_s": 0.1, "at_s": 0.2}])
            lifted = hil_rig.run(1.0).truth
            angle = math.radians(1.0)
            assert turned["mechanism_rad"] == pytest.approx(angle, abs=1e-9)
            assert turned["height_mm"][-1] == pytest.approx(2.0, abs=1e-6)
            assert lifted["height_mm"][0] == pytest.approx(2.0, abs=1e-6)
            assert lifted["height_mm"][-1] == pytest.approx(2.5, abs=1e-6)
            assert abs(lifted["height_mm"][150] - 2.0) < 1e-6  # at_s counts from the call
        """
    )
    pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider").assert_outcomes(passed=1)


@pytest.mark.real_time
@pytest.mark.alone
def test_in_real_time_disturbances_and_the_limit_are_as_in_simulated_time(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest

        def test_moved(hil_live_rig):
            hil_live_rig.compensate()
            still = hil_live_rig.run(0.5).records["stroke_mm"]
            hil_live_rig.disturb(vertical=[
                {"kind": "move", "up_mm": 4.0, "speed_mm_s": 4.0, "acceleration_mm_s2": 20.0}])
            run = hil_live_rig.run(3.0)
            assert run.mode == "COMPENSATING"
            taken = run.records["stroke_mm"][-1] - still[-1]
            assert abs(taken - 4.0) < 0.2  # the stroke takes up what the payload has risen, but for backlash and ripple
            with pytest.raises(ValueError, match="vertical.0") as refused:
                hil_live_rig.disturb(vertical=[{"kind": "move", "up_mm": "high"}])
            assert "\\n" not in str(refused.value)
            with pytest.raises(ValueError, match="mass: found a change of mass on a rigid mechanism"):
                hil_live_rig.disturb(mass=[{"change_kg": 1.0, "at_s": 0.0}])

        @pytest.mark.hil(timeout_s=20)
        def test_limited(hil_live_rig):
            with pytest.raises(AssertionError, match="the test may take 20 s: .* and 21 s are asked for"):
                hil_live_rig.run(21.0)
            with pytest.raises(AssertionError, match="not in HOLD within 0.5 s, but in DISARMED"):
                hil_live_rig.run_until("HOLD", 0.5)
            with pytest.raises(AssertionError, match="not in HOLD within 1?[0-9][.0-9]* s, but in DISARMED"):
                hil_live_rig.run_until("HOLD", 1000.0)
            with pytest.raises(AssertionError, match="the test may take 20 s"):
                hil_live_rig.do("arm")
        """
    )
    pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider").assert_outcomes(passed=2)


REFUSED = (
    ("hil_rig.run(3.1)", "the test may take 3 s of simulated time: 0.2 s are used and 3.1 s are asked for"),
    ("hil_rig.run_until('HOLD', 1.0)", "not in HOLD within 1 s of simulated time, but in DISARMED"),
    ("hil_rig.do('tension')", "tension was refused in DISARMED: WRONG_MODE"),
    ("hil_rig.inject('none_such')", "found 'none_such', expected a fault of the catalogue"),
    ("hil_rig.command('fly')", "found command 'fly', expected"),
    ("hil_rig.disturb(mass=[{'change_kg': 'x'}])", "mass.0"),
    (
        "hil_rig.disturb(mass=[{'change_kg': 1.0, 'at_s': 0.0}])",
        "mass: found a change of mass on a rigid mechanism",
    ),
    ("hil_rig.run(0.1).figure('eta')", "found figure 'eta', expected eta_max_pct"),
)


def test_what_cannot_be_is_one_line(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        f"""
        import pytest

        @pytest.mark.hil(timeout_s=3)
        def test_it(hil_rig):
            for body, says in {REFUSED!r}:
                with pytest.raises((ValueError, AssertionError)) as refused:
                    eval(body)
                assert says in str(refused.value)
                assert "\\n" not in str(refused.value)
        """
    )
    pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider").assert_outcomes(passed=1)


WRONG_MARKERS = {
    'rig="none.yaml"': "none.yaml",
    "seed=3": "marker hil: found seed, expected rig, change, timeout_s",
    'change={"plant.none": 3}': "marker hil: change: plant.none",
}


def test_a_marker_that_is_wrong_is_said_without_a_traceback(pytester: pytest.Pytester) -> None:
    tests = (
        f"@pytest.mark.hil({marker})\ndef test_{number}(hil_rig):\n    pass\n"
        for number, marker in enumerate(WRONG_MARKERS)
    )
    pytester.makepyfile("import pytest\n" + "\n".join(tests))
    done = pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider")
    done.assert_outcomes(errors=len(WRONG_MARKERS))
    for says in WRONG_MARKERS.values():
        assert says in done.stdout.str()
    assert "Traceback" not in done.stdout.str()


def test_a_run_without_a_rig_loads_none(pytester: pytest.Pytester) -> None:
    """The plugin neither slows nor breaks the tests of other projects in the same environment."""
    pytester.makepyfile(
        """
        import json, pathlib, sys

        def test_nothing():
            pathlib.Path("loaded.json").write_text(json.dumps(sorted(sys.modules)))
        """
    )
    pytester.runpytest_subprocess("-q", "-p", "no:cacheprovider", "--strict-markers").assert_outcomes(passed=1)
    loaded = set(json.loads(pathlib.Path(pytester.path / "loaded.json").read_text()))
    assert {name for name in loaded if name.split(".")[0] in ("hil", "rigctl")} == {
        "hil", "hil.testing", "hil.testing.plugin", "rigctl",
    }  # fmt: skip
