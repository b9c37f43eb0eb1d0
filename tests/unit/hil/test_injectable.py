"""Faults that `python -m hil inject --list` offers: a served rig with the devices takes each of them."""

from __future__ import annotations

import pytest

from hil.cli import inject
from hil.faults.catalogue import CATALOGUE
from hil.faults.judging.standing import FaultRefusedError, StandingFault, hindrance
from hil.faults.served import ServedRig, possible
from hil.hub import Hub
from hil.rig import SimulatedRig
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file
from tests.builders.paths import ROOT

PAPER = ROOT / "config/paper_rig.yaml"


def test_a_served_rig_refuses_a_listed_fault_for_a_missing_device_alone() -> None:
    settings, hub = rig_file.load(PAPER), Hub(lambda: 0)
    rig = ServedRig(settings, SimulatedRig(settings, 0, hub.attach(lambda _: None).send), hub)
    refused = set()
    for row in CATALOGUE:
        if not hindrance(row, served=True):
            try:
                StandingFault(rig, row, 0).end()
            except FaultRefusedError as error:
                refused.add(str(error).partition(": ")[2])
    assert refused == {"this rig has no I/O node", "this rig has no rail encoder", "this rig has no second force path"}


def test_the_list_of_a_rig_leaves_out_what_its_devices_cannot_have(capsys: pytest.CaptureFixture[str]) -> None:
    assert inject.show_list(None, for_this_rig=False) == 0
    every = capsys.readouterr().out.splitlines()
    assert inject.show_list(PAPER, for_this_rig=True) == 0
    of_paper = capsys.readouterr().out.splitlines()
    assert {"I/O node:", "rail encoder:"} <= set(every) - set(of_paper)
    assert set(of_paper) <= set(every)
    groups = [line for line in of_paper if not line.startswith(" ")]
    assert len(groups) == len(set(groups))
    assert len(of_paper) - len(groups) == len(possible(rig_file.load(PAPER), (
        row for row in CATALOGUE if not hindrance(row, served=True)
    )))  # fmt: skip


def test_a_list_of_no_rig_is_refused() -> None:
    with pytest.raises(ScenarioError, match="expected RIG --list --for-this-rig"):
        inject.show_list(None, for_this_rig=True)


def test_faults_are_left_to_a_wire_of_the_simulator() -> None:
    settings = rig_file.load(PAPER)
    elsewhere = settings.model_copy(update={"can": settings.can.model_copy(update={"interface": "socketcan"})})
    silent = [row for row in CATALOGUE if row.id == "cell_silent"]
    assert possible(settings, silent) == silent
    assert not possible(elsewhere, silent)
