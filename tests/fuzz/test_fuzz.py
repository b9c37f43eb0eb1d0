"""A share of the fuzzing, and regressions that fuzzing has found."""

from __future__ import annotations

import pathlib
import random
import struct

import pytest

from hil.hub import Port
from hil.wire import FRAME
from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.config.rig_file import ConfigError
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from rigctl.devices import objects as od
from rigctl.devices.remote_node import StartupError
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.wire.command_request import RequestError, parse
from tests.builders.paths import ROOT
from tests.builders.rig_on_hub import RigOnHub
from tests.fuzz import commands, device_files, eds_mutants, files, frames, mutate, replies, startup_files
from tests.fuzz.judge import Tally


@pytest.fixture(scope="module")
def settings() -> RigSettings:
    return config.load(ROOT / "config/paper_rig.yaml")


@pytest.fixture(scope="module")
def gains(settings: RigSettings) -> Gains:
    return design_and_check(settings).gains


def test_whatever_comes_from_the_bus_what_leaves_for_the_drive_is_finite_and_inside_its_limits(
    settings: RigSettings, gains: Gains
) -> None:
    runs = [frames.play(settings, gains, 50_000, seed=seed) for seed in (3, 4)]  # one run trips in few ways
    modes, faults = set[str]().union(*(run.modes for run in runs)), set[str]().union(*(run.faults for run in runs))
    assert [run.wrong for run in runs] == [[], []]
    assert modes == {mode.name for mode in Mode}, "they reached every mode"
    assert len(faults) > 5, "NONE and five ways to trip"
    assert "LOOP_EXCEPTION" not in faults


def test_whatever_an_io_node_sends_what_leaves_for_the_drive_stays_inside_its_limits(
    settings: RigSettings, gains: Gains
) -> None:
    fitted = settings.model_copy(update={"io": IoSettings(e_stop_input=3)})
    runs = [frames.play(fitted, gains, 30_000, seed=seed) for seed in (5, 10)]  # one of ten runs trips by its input
    modes, faults = set[str]().union(*(run.modes for run in runs)), set[str]().union(*(run.faults for run in runs))
    assert [run.wrong for run in runs] == [[], []]
    assert modes >= {"HOLD", "TENSIONING", "FAULT"}
    assert "E_STOP" in faults
    assert "LOOP_EXCEPTION" not in faults


def test_a_command_is_refused_in_one_line_or_does_what_a_command_may(settings: RigSettings, gains: Gains) -> None:
    found = commands.play(settings, gains, 1000, seed=1)
    assert found.wrong == []
    assert found.taken["command"] > 200
    assert found.tried["command"] - found.taken["command"] > 200
    assert {name for name in found.taken if name.startswith("in ")} >= {"in HOLD", "in TENSIONING", "in FAULT"}


def test_a_file_is_taken_or_refused_in_plain_lines() -> None:
    found = files.play(120, 60, 1, seed=1)  # one mutant of a ledger in thirty is taken
    assert found.wrong == []
    for name in ("rig file", "scenario", "DBC file", "calibration ledger", "gain file"):
        assert 0 < found.taken[name] < found.tried[name]


def test_a_file_read_at_a_start_may_be_damaged_in_any_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/nowhere")  # the fixture restores it
    found = startup_files.play(40, seed=1)
    assert found.wrong == []
    assert set(found.tried.values()) == {40}
    for name in ("active.json", "control.json", "recorder.json", "calibration.json", "lease.json", "lock"):
        assert found.taken[name] == found.tried[name], name  # the process went on without the file
    for name in ("rig file", "DBC file", "EDS file", "gain file", "calibration ledger", "audit log", "recording"):
        assert found.tried[name] - found.taken[name] > 0, name


def test_a_device_file_that_check_passes_starts_with_the_devices_own_values() -> None:
    found = device_files.play(len(eds_mutants.CHANGES), seed=1)
    assert found.wrong == []
    for name in ("EDS: encoding", "EDS: letter_case", "DBC: encoding", "DBC: line ends"):
        assert found.taken[name] == found.tried[name], name
    for name in ("EDS: of_another_device", "EDS: few_objects", "DBC: bytes"):
        assert found.taken[name] < found.tried[name], name


def test_start_up_ends_whatever_a_device_answers(settings: RigSettings) -> None:
    found = replies.play(settings, 80, seed=1)
    assert found.wrong == []
    assert found.taken["start-up"] < 80
    assert {name for name in found.tried if name.startswith("answered: ")} >= {"answered: endless", "answered: short"}


def test_what_is_wrong_is_found() -> None:
    tally, chance = Tally(), random.Random(1)
    assert tally.attempt("good", b"", lambda: 1, ()) == 1
    assert tally.attempt("refused", b"", lambda: int("x"), (ValueError,)) is None
    assert tally.wrong == []
    tally.attempt("thrown", b"", lambda: 1 // int(not chance), (ValueError,))
    tally.attempt("two lines", b"", lambda: int("x\ny") if chance else 0, ())
    assert len(tally.wrong) == 2
    assert any(mutate.data({"a": [1, 2.0, "b"]}, chance) != {"a": [1, 2.0, "b"]} for _ in range(3))


def answering(settings: RigSettings, lie: object) -> str:
    """Message of the start-up when every SDO response of the devices is replaced."""
    rig = RigOnHub(settings)

    def tap(sender: Port, frame: bytes) -> list[bytes]:
        can_id, length, data = FRAME.unpack(frame)
        if sender is not rig.port or can_id not in {od.SDO_TX_BASE + node for node in settings.canopen_nodes.values()}:
            return [frame]
        said = lie(data[:length])  # type: ignore[operator]
        return [FRAME.pack(can_id, len(said), said)]

    rig.hub.tap = tap
    with pytest.raises(StartupError) as error:
        rig.bring_up()
    return str(error.value)


def test_a_device_that_sends_segments_without_end_does_not_keep_the_start_waiting(settings: RigSettings) -> None:
    toggle = [0]

    def lie(data: bytes) -> bytes:
        if data[0] != 0x80:
            toggle[0] = 0
            return b"\x41" + data[1:4] + struct.pack("<L", 2**31)
        toggle[0] ^= 0x10
        return bytes([toggle[0] ^ 0x10]) + data[1:]

    assert "cylinder drive (node 4), object 0x6041:00: answered with what is no SDO answer" in answering(settings, lie)


@pytest.mark.parametrize("lie", [lambda _: b"", lambda data: data[:2], lambda data: bytes([data[0] | 0x0C]) + data[1:]])
def test_an_answer_of_the_wrong_length_ends_the_start_in_one_line(settings: RigSettings, lie: object) -> None:
    said = answering(settings, lie)
    assert "object 0x6041:00" in said
    assert said.isprintable()


@pytest.mark.parametrize("value", ["x" * 5000, "a\u2028b", "\u202eabc"])
def test_what_a_rig_file_holds_is_quoted_in_one_printable_line(tmp_path: pathlib.Path, value: str) -> None:
    file = tmp_path / "rig.yaml"
    text = (ROOT / "config/paper_rig.yaml").read_text()
    file.write_text(text.replace("rate_hz: 1000", f'rate_hz: "{value}"', 1))
    with pytest.raises(ConfigError) as refused:
        config.load(file)
    assert all(line.isprintable() and len(line) < 700 for line in refused.value.findings)


def test_an_unknown_key_of_a_command_is_quoted_in_one_printable_line() -> None:
    with pytest.raises(RequestError) as refused:
        parse(Verb.ARM, '{"operator": "anna", "\u2028": 1}'.encode())
    assert str(refused.value).isprintable()
