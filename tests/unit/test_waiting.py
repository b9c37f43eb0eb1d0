"""The one place that knows how long a test waits."""

from __future__ import annotations

import os
import pathlib

import pytest

from tests.builders import waiting


def test_the_limit_grows_with_the_work_that_others_give_the_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.delenv(waiting.FACTOR, raising=False)
    for load, limit_s in ((0.0, 60.0), (2.0, 60.0), (13.0, 390.0)):
        monkeypatch.setattr(os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        assert waiting.patience_s() == limit_s
    monkeypatch.setenv(waiting.FACTOR, "10")
    assert waiting.patience_s(5.0) == 325.0


def test_a_wait_for_what_never_comes_says_what_it_was_and_shows_the_log(
    monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path
) -> None:
    monkeypatch.setattr(waiting, "patience_s", lambda: 0.1)
    log = tmp_path / "a.log"
    log.write_text("FAULT BUS_SILENT")
    with pytest.raises(AssertionError, match=r"the rig's answer\nFAULT BUS_SILENT"):
        waiting.until(lambda: False, "the rig's answer", log=log)
    with pytest.raises(AssertionError, match=r"log\.name is None\) \(test_waiting\.py:\d+\)"):
        waiting.until(lambda: log.name is None)
    assert waiting.until(lambda: 7) == 7
