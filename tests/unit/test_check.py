"""`make check` finds the tests that a change touches, and leaves out what takes too long."""

from __future__ import annotations

import pathlib

import pytest

from tests import check
from tests.builders.paths import ROOT


@pytest.mark.parametrize(
    ("file", "first", "also"),
    [
        ("rigctl/metrics/windows.py", "tests/unit/metrics", None),
        ("rigctl/control/watch/safety.py", "tests/unit/control/test_safety.py", "tests/loop"),
        ("rigctl/page/static/page.css", "tests/unit/page", None),
        ("hil/plant/rope.py", "tests/unit/hil", "tests/plant"),
        ("config/rig.yaml", "tests/unit/config", None),
        ("docs/operate.md", "tests/unit/test_docs.py", None),
        ("tests/unit/test_check.py", "tests/unit/test_check.py", None),
    ],
)
def test_a_changed_file_has_the_tests_that_mirror_it(file: str, first: str, also: str | None) -> None:
    found = check.mirrored(file)
    assert found[0] == first
    assert also is None or also in found
    assert all((ROOT / place).exists() for place in found)


def test_every_folder_of_the_table_and_its_tests_exist() -> None:
    for folder, places in check.ELSEWHERE.items():
        assert (ROOT / folder).is_dir()
        assert all((ROOT / place).exists() for place in places), folder


def test_what_does_not_fit_is_left_and_what_fits_after_it_is_run() -> None:
    seconds = {"slow": 90.0, "slower": 200.0, "quick": 20.0}
    assert check.within(["slow", "slower", "quick"], seconds, 120.0) == (["slow", "quick"], ["slower"])


def test_one_file_is_checked_and_one_that_is_not_there_is_one_line(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "DURATIONS", tmp_path / "none.json")
    assert check.main(["--file", "tests/unit/test_waiting.py"]) == 0
    assert " passed" in capfd.readouterr().out
    assert check.main(["--file", "rigctl/no_such.py"]) == 2
    assert capfd.readouterr().err == "tests.check: rigctl/no_such.py: no such file in the project\n"
