"""A rig file is read exactly, or refused with one line that gives place and reason."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.config import strict_yaml
from rigctl.model.quantity import unit_of
from tests.builders.paths import ROOT

PAPER = (ROOT / "config/paper_rig.yaml").read_text()


SLOW_STATUS = PAPER.replace("  rate_hz: 1000\n", "  rate_hz: 4000\n", 1).replace(
    "status_rate_hz: 20 ", "status_rate_hz: 5 "
)

Refuse = Callable[[str, str], list[str]]


@pytest.fixture
def refuse(tmp_path: pathlib.Path) -> Refuse:
    (tmp_path / "eds").symlink_to(ROOT / "config/eds")
    file = tmp_path / "rig.yaml"

    def findings(old: str, new: str) -> list[str]:
        assert old in PAPER
        file.write_text(PAPER.replace(old, new, 1))
        with pytest.raises(config.ConfigError) as error:
            config.load(file)
        return [line.replace(str(file), "FILE") for line in error.value.findings]

    return findings


@pytest.mark.parametrize("name", ["paper_rig.yaml", "plain_rig.yaml", "rig.yaml"])
def test_the_files_we_ship_are_accepted(name: str) -> None:
    settings = config.load(ROOT / "config" / name)
    assert settings.loop.period_ns == 1_000_000
    assert math.isclose(1 / settings.plant.stiffness_n_mm, 1 / 6 + 1 / 1000)
    assert settings.can.interface == ("socketcan" if name == "rig.yaml" else "rigsim")
    assert len(settings.plain_messages) == (2 if name == "plain_rig.yaml" else 0)


def test_the_plain_rig_is_the_papers_but_for_its_sensors_and_name() -> None:
    paper, plain = (config.load(ROOT / "config" / name).model_dump() for name in ("paper_rig.yaml", "plain_rig.yaml"))
    for section in ("tension_cell", "inclinometer"):
        assert plain[section].pop("dbc") and paper[section].pop("dbc") is None
    del plain["rig"], paper["rig"], plain["can"]["channel"], paper["can"]["channel"], plain["plain"], paper["plain"]
    assert plain == paper


@pytest.mark.parametrize(
    ("old", "new", "key", "allowed"),
    [
        ("rated_current_a: 3.0", "rated_current_a: null", "cylinder.rated_current_a", "with status_rate_hz"),
        ("status_rate_hz: 20 ", "status_rate_hz: null ", "cylinder.e_stop_input", "none without status_rate_hz"),
        pytest.param(PAPER, SLOW_STATUS, "cylinder.status_rate_hz", "divided by 1 to 240", id="status too slow"),
        ("stroke_margin_mm: 2.0", "stroke_margin_mm: 70.0", "preflight.stroke_margin_mm", "less than half the stroke"),
        (
            'realtime_waiver: "simulated rig: a late tick harms nobody"',
            "realtime_waiver: no",
            "loop.realtime_waiver",
            "",
        ),
    ],
)
def test_a_drives_status_and_a_preflight_that_do_not_fit_are_refused(
    refuse: Refuse, old: str, new: str, key: str, allowed: str
) -> None:
    (line,) = refuse(old, new)
    assert f" {key}: " in line
    assert allowed in line


ENCODER = "rail_encoder: {counts_per_turn: 1048576, rate_hz: 1000}\n"
RUN_OUT = "run_out: {angle_min_deg: -3.0, angle_max_deg: 16.0, bins: 38, learning_rate: 0.5}\n"


def test_no_rig_has_a_rail_encoder_or_a_run_out_table_unless_it_says_so(tmp_path: pathlib.Path) -> None:
    settings = config.load(ROOT / "config/paper_rig.yaml")
    assert settings.rail_encoder is settings.run_out is None
    assert "rail_encoder" not in settings.canopen_nodes
    (tmp_path / "eds").symlink_to(ROOT / "config/eds")
    file = tmp_path / "rig.yaml"
    file.write_text(PAPER + ENCODER + RUN_OUT)
    settings = config.load(file)
    assert settings.canopen_nodes["rail_encoder"] == 5
    assert settings.run_out is not None
    assert settings.run_out.min_speed_deg_s == 0.1


@pytest.mark.parametrize(
    ("new", "key", "allowed"),
    [
        (RUN_OUT, "run_out", "none without a rail_encoder section"),
        (ENCODER.replace("1000", "300"), "rail_encoder.rate_hz", "divided by 1 to 240"),
        (ENCODER.replace("{", "{node: 3, "), "rail_encoder.node", "a node id of its own"),
        (ENCODER.replace("{", "{eds: none.eds, "), "rail_encoder.eds", "an EDS file"),
        (ENCODER + RUN_OUT.replace("16.0", "-4.0"), "run_out.angle_min_deg", "below angle_max_deg"),
        (ENCODER + RUN_OUT.replace("16.0", "350.0"), "run_out.angle_max_deg", "a turn less one bin"),
    ],
)
def test_a_rail_encoder_and_a_table_that_do_not_fit_are_refused(
    refuse: Refuse, new: str, key: str, allowed: str
) -> None:
    (line,) = refuse("rig: paper_rig\n", f"rig: paper_rig\n{new}")
    assert f" {key}: " in line
    assert allowed in line


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        ("cylinder_lag_s: 0.02", "cylinder_lag_s: 1e-3", "plant.cylinder_lag_s", "1e-3", "1.0e-3"),
        ("cylinder_lag_s: 0.02", "cylinder_lag_s: .nan", "plant.cylinder_lag_s", ".nan", "finite"),
        ("cylinder_lag_s: 0.02", "cylinder_lag_s: .inf", "plant.cylinder_lag_s", ".inf", "finite"),
        ("cylinder_lag_s: 0.02", "cylinder_lag_s: 5.0", "plant.cylinder_lag_s", "5.0", "in s, above 0 to 1"),
        ("target_n: 300.0", "target_n: 300 N", "tension.target_n", "'300 N'", "a number in N, 1 to 10000"),
        ("target_n: 300.0", "target_n: 3000.0", "tension.target_n", "3000.0", "50 to 350"),
        ("target_n: 300.0", "target_kn: 0.3", "tension.target_kn", "unknown key", "target_n?"),
        ("priority: 80", "priority: 010", "loop.priority", "010", "finite number"),
        ("priority: 80", "priority: 0x50", "loop.priority", "0x50", "finite number"),
        ("priority: 80", "priority: 12:30", "loop.priority", "12:30", "finite number"),
        ("priority: 80", "priority: 80.0", "loop.priority", "80.0", "a whole number, 0 to 98"),
        ("lock_memory: true", "lock_memory: yes", "loop.lock_memory", "yes", "true or false"),
        ("lock_memory: true", "lock_memory: 1", "loop.lock_memory", "1", "true or false"),
        ("bitrate_bit_s: 1000000", "bitrate_bit_s: 1 Mbit/s", "can.bitrate_bit_s", "'1 Mbit/s'", "bit/s"),
        ("channel: /tmp/rigctl-paper_rig.sock", "channel: 5", "can.channel", "5", "in quotes"),
        ("channel: /tmp/rigctl-paper_rig.sock", "channel: 1.2.3", "can.channel", "1.2.3", "in quotes"),
        (
            "channel: /tmp/rigctl-paper_rig.sock",
            f"channel: /tmp/{'x' * 104}",
            "can.channel",
            "x'",
            "1 to 100 characters",
        ),
        (
            "channel: /tmp/rigctl-paper_rig.sock",
            f"channel: /tmp/{'ü' * 52}",
            "can.channel",
            "ü",
            "at most 107 bytes",
        ),
        ("interface: rigsim", "interface: rigsm", "can.interface", "rigsm (rigsim?)", "of python-can: canalystii, "),
        ("interface: rigsim", "interface: SocketCAN", "can.interface", "SocketCAN", "of python-can: "),
        ("spin_us: 80", "rate_hz: 60", "loop.rate_hz", "the key twice", "once"),
        ("  node: 3", "  node: 2", "inclinometer.node", "2", "tension_cell has it"),
        ("heartbeat_timeout_ms: 60", "heartbeat_timeout_ms: 30", "cylinder.heartbeat_timeout_ms", "30", "(40)"),
        ("rate_hz: 1000", "rate_hz: 700", "loop.rate_hz", "700", "whole number of nanoseconds"),
        ("tension_high_n: 400.0", "tension_high_n: 300.0", "tension.target_max_n", "350.0", "(300)"),
        ("  node: 3", "  node: 112", "inclinometer.node", "112", "the simulator has it"),
        ("node: 2", "node: 2\n  eds: nothing.eds", "tension_cell.eds", "no file nothing.eds", "EDS"),
    ],
)
def test_a_bad_value_gets_one_line(refuse: Refuse, old: str, new: str, key: str, found: str, allowed: str) -> None:
    (line,) = refuse(old, new)
    prefix, _, rest = line.partition(": ")
    assert prefix.startswith("FILE:")
    number = int(prefix.removeprefix("FILE:"))
    written = PAPER.replace(old, new, 1).splitlines()[number - 1]
    assert written.strip().startswith(key.rpartition(".")[2] + ":")
    assert rest.startswith(f"{key}: found ")
    assert found in rest.partition(", expected")[0]
    assert allowed in rest.partition(", expected")[2]


def test_an_address_is_text(tmp_path: pathlib.Path) -> None:
    (tmp_path / "eds").symlink_to(ROOT / "config/eds")
    (tmp_path / "rig.yaml").write_text(PAPER.replace("channel: /tmp/rigctl-paper_rig.sock", "channel: 239.74.163.77"))
    assert config.load(tmp_path / "rig.yaml").can.channel == "239.74.163.77"


def test_each_of_several_bad_values_gets_its_line(refuse: Refuse) -> None:
    lines = refuse("  rate_hz: 1000\n  spin_us: 80", "  rate_hz: 5\n  spin_us: 999")
    assert [line.split(": ")[1] for line in lines] == ["loop.rate_hz", "loop.spin_us"]


def test_a_missing_section_and_a_broken_file_are_one_line_each(refuse: Refuse) -> None:
    (line,) = refuse("plant:  ", "plamt:  ")
    assert "plamt: found an unknown key, expected plant?" in line
    (line,) = refuse("interface: rigsim", "interface: [rigsim")
    assert "not YAML" in line


@pytest.mark.parametrize("text", ["", "- 1\n", "a: &x [*x]\n", "\x00", "a: !!python/object:os.system x\n", "{" * 5000])
def test_what_is_not_a_rig_file_is_refused(tmp_path: pathlib.Path, text: str) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with pytest.raises(config.ConfigError) as error:
        config.load(file)
    assert str(error.value).startswith(str(file))


def test_a_file_that_cannot_be_read_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(config.ConfigError, match="cannot be read"):
        config.load(tmp_path / "none.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"rig: \xff\xfe\n")
    with pytest.raises(config.ConfigError, match="not UTF-8"):
        config.load(tmp_path / "latin.yaml")


@given(st.text(max_size=200))
def test_no_text_gets_past_the_loader_but_as_data_or_refusal(text: str) -> None:
    try:
        document = strict_yaml.load(text)
    except strict_yaml.StrictYamlError as error:
        assert error.line >= 1
        assert "\n" not in error.message
    else:
        assert document.line_of(("a", 0)) >= 1


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_written_in_full_reads_back(value: float) -> None:
    text = repr(value) if "." in repr(value) else f"{value:.17e}"
    text = text.replace("e-0", "e-").replace("e+0", "e+") if "e" in text else text
    if "e" in text and text.split("e")[1][0] not in "+-":
        text = text.replace("e", "e+")
    assert strict_yaml.load(f"x: {text}\n").data == {"x": value}


def test_every_field_says_its_unit_or_has_none() -> None:
    named = {"_n": "N", "_mm": "mm", "_mm_s": "mm/s", "_n_mm": "N/mm", "_hz": "Hz", "_ms": "ms", "_bit_s": "bit/s"}
    for suffix, unit in named.items():
        assert unit_of("x" + suffix) == unit
