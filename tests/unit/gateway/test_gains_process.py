"""Gains for a running rig are judged in a process of its own."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.control.excitation import frequency_trial
from rigctl.gateway.gains_process import admit
from rigctl.ipc import calculation
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.verbs import Verb
from rigctl.operations.gain_admission import NotAdmittedError


def test_a_gate_that_takes_too_long_refuses_in_words(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calculation, "LIMIT_S", 0.01)
    with pytest.raises(NotAdmittedError, match=r"the gains were not judged within 0\.01 s"):
        admit(Runtime(tmp_path), "", "a.gains.yaml")


def test_a_rig_without_settings_refuses_in_words(tmp_path: pathlib.Path) -> None:
    with pytest.raises(NotAdmittedError, match=r"active\.json holds no valid settings"):
        admit(Runtime(tmp_path), "", "a.gains.yaml")


def test_a_client_waits_longer_than_the_gate_may_take() -> None:
    assert Verb.GAINS.row.answered_s > calculation.LIMIT_S
    assert Verb.RESPONSE.row.answered_s > frequency_trial.LONGEST_S + calculation.LIMIT_S
