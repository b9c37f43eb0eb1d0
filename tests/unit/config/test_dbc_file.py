"""A device's DBC section is read exactly, or refused with one line that gives place and reason."""

from __future__ import annotations

import math
import pathlib
import subprocess
import sys
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as run_with
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.devices import busload
from tests.builders.paths import ROOT
from tests.conftest import Command

CONFIG = ROOT / "config"
RIG = (CONFIG / "plain_rig.yaml").read_text()
DBC = (CONFIG / "plain_sensors.dbc").read_text()

Write = Callable[[str, str], pathlib.Path]


@pytest.fixture
def write(tmp_path: pathlib.Path) -> Write:
    """Write a rig file and its DBC file beside the EDS file of the drive, the only one a plain rig needs."""
    (tmp_path / "eds").mkdir()
    (tmp_path / "eds/cylinder_drive.eds").symlink_to(CONFIG / "eds/cylinder_drive.eds")

    def files(rig: str, dbc: str) -> pathlib.Path:
        (tmp_path / "plain_sensors.dbc").write_text(dbc, encoding="cp1252")
        (tmp_path / "rig.yaml").write_text(rig)
        return tmp_path / "rig.yaml"

    return files


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def refusal(file: pathlib.Path) -> str:
    with pytest.raises(config.ConfigError) as error:
        config.load(file)
    (line,) = error.value.findings
    return line.replace(str(file), "FILE")


def line_of(section: str, key: str, rig: str = RIG) -> int:
    """1-based line of ``key`` in ``section``, found by text search, without the parser."""
    lines = rig.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(section + ":"))
    return next(i for i in range(start, len(lines)) if lines[i].strip().startswith(key + ":")) + 1


def test_the_layout_is_what_the_dbc_file_says() -> None:
    settings = config.load(CONFIG / "plain_rig.yaml")
    cell, slope = settings.plain_messages["tension_cell"], settings.plain_messages["inclinometer"]
    assert (cell.can_id, cell.size, cell.cycle_ms) == (0x110, 5, 1)
    assert (slope.can_id, slope.size, slope.cycle_ms) == (0x111, 5, 10)
    assert cell.signals["tension"].scale == 0.001
    assert slope.signals["tangential"].scale == pytest.approx(math.radians(0.01), rel=1e-15)
    assert settings.canopen_nodes == {"cylinder": 4}


def test_a_signal_in_rad_is_taken_as_it_is(write: Write) -> None:
    settings = config.load(write(RIG, DBC.replace('"deg"', '"rad"')))
    assert settings.plain_messages["inclinometer"].signals["normal"].scale == 0.01


def test_the_settings_cross_to_the_other_processes_whole() -> None:
    settings = config.load(CONFIG / "plain_rig.yaml")
    assert RigSettings.model_validate_json(settings.model_dump_json()) == settings
    assert RigSettings.model_validate(settings.model_dump(mode="json")) == settings


def test_a_null_section_is_canopen(write: Write) -> None:
    settings = config.load(CONFIG / "paper_rig.yaml")
    assert settings.plain_messages == {}
    assert settings.canopen_nodes == {"tension_cell": 2, "inclinometer": 3, "cylinder": 4}
    start, end = RIG.index("  dbc:"), RIG.index("  range_n:")
    file = write(RIG[:start] + "  dbc: null\n" + RIG[end:], DBC)
    assert "no file eds/tension_amplifier.eds" in refusal(file)


def test_a_rig_without_dbc_sections_does_not_import_cantools() -> None:
    load = "from rigctl.config import rig_file; rig_file.load(sys.argv[1])"
    code = f"import sys; {load}; sys.exit('cantools' in sys.modules)"
    for name, imported in (("paper_rig.yaml", 0), ("plain_rig.yaml", 1)):
        assert subprocess.run([sys.executable, "-c", code, str(CONFIG / name)], check=False).returncode == imported


def test_the_control_process_never_imports_cantools() -> None:
    code = (
        "import json, sys; from rigctl.control import control_process; from rigctl.config.settings import RigSettings\n"
        "from rigctl.control.bus.inbox import Inbox\n"
        "Inbox(None, RigSettings.model_validate(json.loads(sys.stdin.read())), None, None)\n"
        "sys.exit('cantools' in sys.modules)"
    )
    settings = config.load(CONFIG / "plain_rig.yaml").model_dump_json()
    subprocess.run([sys.executable, "-c", code], input=settings, text=True, check=True)


CELL, SLOPE = "tension_cell.dbc", "inclinometer.dbc"
TENSION, VALID = "SG_ RopeTension : 0|32@1- (0.001,0)", "SG_ TensionValid : 32|1@1+ (1,0)"
MANY_DIGITS = "1" + "0" * 400


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        ("file: plain_sensors.dbc", "file: none.dbc", f"{CELL}.file", "no file none.dbc", "a DBC file"),
        ("file: plain_sensors.dbc", "file: eds", f"{CELL}.file", "no file eds", "a DBC file"),
        (
            "file: plain_sensors.dbc",
            "file: rig.yaml",
            f"{CELL}.file",
            """rig.yaml, which cannot be read (DBC: "Invalid syntax at line 1, column 1: """
            """">>!<<# yaml-language-server: $schema=schema/rig.schema.json"")""",
            "a DBC file",
        ),
        (
            "message: Tension",
            "message: Tensoin",
            f"{CELL}.message",
            "no message Tensoin in plain_sensors.dbc",
            "Inclination or Tension",
        ),
        (
            "tension: RopeTension",
            "tension: Rope",
            f"{CELL}.tension",
            "no signal Rope in message Tension",
            "RopeTension or TensionValid",
        ),
        (
            "valid: AngleValid",
            "valid: Ok",
            f"{SLOPE}.valid",
            "no signal Ok in message Inclination",
            "AngleNormal or AngleTangential or AngleValid",
        ),
        ("tension: RopeTension", "tension: TensionValid", f"{CELL}.tension", "no unit", "unit N"),
    ],
)
def test_a_rig_file_that_asks_for_what_is_not_there(
    write: Write, old: str, new: str, key: str, found: str, allowed: str
) -> None:
    rig = changed(RIG, old, new)
    section, _, name = key.rpartition(".")
    number = line_of(section.split(".")[0], name, rig)
    assert refusal(write(rig, DBC)) == f"FILE:{number}: {key}: found {found}, expected {allowed}"


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        ('] "N" C', '] "kN" C', f"{CELL}.tension", "unit kN", "unit N"),
        ('] "deg" C', '] "°" C', f"{SLOPE}.tangential", "unit °", "unit deg or rad"),
        ('] "deg" C', '] "" C', f"{SLOPE}.tangential", "no unit", "unit deg or rad"),
        (TENSION, TENSION.replace("0.001", "0"), f"{CELL}.tension", "scale 0", "a finite scale, not 0"),
        (TENSION, TENSION.replace("0.001", MANY_DIGITS), f"{CELL}.tension", "scale inf", "a finite scale, not 0"),
        (TENSION, TENSION.replace(",0)", ",1E999)"), f"{CELL}.tension", "offset inf", "a finite offset"),
        (VALID, VALID.replace("(1,0)", "(0,1)"), f"{CELL}.valid", "scale 0", "a finite scale, not 0"),
        (
            "SG_ RopeTension :",
            "SG_ Page M : 33|7@1+ (1,0) [0|0] \"\" X\n SG_ RopeTension m0 :",
            f"{CELL}.tension",
            "RopeTension, which is multiplexed",
            "a signal that is in every frame",
        ),
        (
            "SG_ TensionValid :",
            "SG_ Other m1 : 33|7@1+ (1,0) [0|0] \"\" X\n SG_ TensionValid M :",
            f"{CELL}.valid",
            "TensionValid, which is multiplexed",
            "a signal that is in every frame",
        ),
        ("BO_ 272 Tension: 5", "BO_ 272 Tension: 12", f"{CELL}.message", "Tension with 12 bytes",
         "a classic frame of 1 to 8 bytes"),
        ("BO_ 272 Tension", "BO_ 2147483920 Tension", f"{CELL}.message", "Tension with extended id 0x00000110",
         "a standard id (11 bits)"),
        ("BO_ 273 Inclination", "BO_ 273 Tension", f"{CELL}.message", "2 messages Tension in plain_sensors.dbc", "one"),
        ("BO_ 272", "BO_ 388", f"{CELL}.message", "Tension with id 0x184",
         "an id of its own (cylinder's TPDO has it)"),
        ("BO_ 272", "BO_ 128", f"{CELL}.message", "Tension with id 0x080", "an id of its own (SYNC has it)"),
        ("BO_ 272", "BO_ 1793", f"{CELL}.message", "Tension with id 0x701",
         "an id of its own (the controller's heartbeat has it)"),
        ("BO_ 272", "BO_ 1540", f"{CELL}.message", "Tension with id 0x604",
         "an id of its own (cylinder's SDO request has it)"),
        ('"GenMsgCycleTime" BO_ 272 1;', '"GenMsgCycleTime" BO_ 272 8;', "safety.stale_ms", "15",
         "two cycles of tension_cell's message (16 ms) or more"),
        ('"GenMsgCycleTime" BO_ 273 10;', '"GenMsgCycleTime" BO_ 273 51;', "safety.inclination_stale_ms", "100",
         "two cycles of inclinometer's message (102 ms) or more"),
    ],
)  # fmt: skip
def test_a_dbc_file_that_the_loop_could_not_use(
    write: Write, old: str, new: str, key: str, found: str, allowed: str
) -> None:
    dbc = DBC.replace(old, new, 1)
    assert dbc != DBC
    if "BO_" in old and "GenMsg" not in old and "Inclination" not in old:
        dbc = "\n".join(line for line in dbc.splitlines() if not line.startswith(("CM_ BO", "CM_ SG", "BA_ "))) + "\n"
    section, _, name = key.rpartition(".")
    number = line_of(section.split(".")[0], name)
    assert refusal(write(RIG, dbc)) == f"FILE:{number}: {key}: found {found}, expected {allowed}"


SLOPE_16 = "SG_ AngleTangential : 7|16@0- (0.01,0) [-90|90]"


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        (SLOPE_16, "SG_ AngleTangential : 7|8@0- (0.01,0) [0|0]", f"{SLOPE}.tangential",
         "AngleTangential, whose values begin at -1.28 deg",
         "one that passes -5 (limits.0.low), which could never trip"),
        (SLOPE_16, SLOPE_16.replace("-90|90", "-90|1.27"), f"{SLOPE}.tangential",
         "AngleTangential, whose values end at 1.27 deg", "one that passes 5 (limits.0.high), which could never trip"),
        (SLOPE_16, SLOPE_16.replace("-90|90", "-4|90"), f"{SLOPE}.tangential",
         "AngleTangential, whose values begin at -4 deg", "one that passes -5 (limits.0.low), which could never trip"),
        (SLOPE_16, SLOPE_16.replace("@0-", "@0+").replace("-90|90", "0|0"), f"{SLOPE}.tangential",
         "AngleTangential, whose values begin at 0 deg", "one that passes -5 (limits.0.low), which could never trip"),
        ("[-2000000|2000000]", "[0|400]", f"{CELL}.tension", "RopeTension, whose values end at 400 N",
         "one that passes 400 (safety.tension_high_n), which could never trip"),
        (TENSION, TENSION.replace(",0)", ",30)").replace("32@1-", "32@1+"), f"{CELL}.tension",
         "RopeTension, whose values begin at 30 N",
         "one that passes 20 (safety.tension_low_n), which could never trip"),
        (TENSION, TENSION.replace("32@1-", "16@1-").replace("0.001", "-0.01"), f"{CELL}.tension",
         "RopeTension, whose values end at 327.68 N",
         "one that passes 400 (safety.tension_high_n), which could never trip"),
        (TENSION, TENSION.replace("32@1-", "32@1+").replace("-2000000|", "0|"), f"{CELL}.tension",
         "RopeTension, whose values begin at 0 N", "one that passes -15 (fault CELL_NEGATIVE), which could never trip"),
    ],
)  # fmt: skip
def test_a_signal_that_cannot_pass_a_limit_is_refused(
    write: Write, old: str, new: str, key: str, found: str, allowed: str
) -> None:
    section, _, name = key.rpartition(".")
    number = line_of(section.split(".")[0], name)
    assert refusal(write(RIG, changed(DBC, old, new))) == f"FILE:{number}: {key}: found {found}, expected {allowed}"


def test_a_limit_that_only_logs_or_is_waived_may_be_out_of_reach(write: Write) -> None:
    dbc = changed(DBC, SLOPE_16, SLOPE_16.replace("-90|90", "-4|4"))
    logged = changed(RIG, "tangential_deg, low: -5.0, high: 5.0, persistence_ms: 15, action: hold",
                     "tangential_deg, low: -5.0, high: 5.0, persistence_ms: 15, action: log")  # fmt: skip
    assert config.load(write(logged, dbc)).plain_messages
    assert config.load(write(RIG, dbc), study=True).plain_messages


@pytest.mark.parametrize("declared", ["0|0", f"-20|{MANY_DIGITS}", "-1E999|1E999", "5|-5"])
def test_a_declared_range_that_is_none_bounds_nothing(write: Write, declared: str) -> None:
    file = write(RIG, changed(DBC, "[-2000000|2000000]", f"[{declared}]"))
    signal = config.load(file).plain_messages["tension_cell"].signals["tension"]
    assert signal.most == pytest.approx((2**31 - 1) * 0.001)


def test_a_float_passes_every_limit(write: Write) -> None:
    text = changed(DBC, TENSION, TENSION.replace("(0.001,0)", "(1,0)")) + "\nSIG_VALTYPE_ 272 RopeTension : 1;\n"
    assert config.load(write(RIG, text)).plain_messages["tension_cell"].signals["tension"].floating


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_the_files_of_every_editor_are_read(write: Write, encoding: str) -> None:
    file = write(RIG, DBC)
    (file.parent / "plain_sensors.dbc").write_bytes(
        DBC.replace('CM_ "Two', 'CM_ "Prüfstand, 1 °, two').encode(encoding)
    )
    assert config.load(file).plain_messages["tension_cell"].name == "Tension"


def test_what_cantools_has_to_say_of_messages_that_we_do_not_use_is_not_printed(write: Write) -> None:
    twice = "".join(f"\nBO_ {id_} Other: 8 TensionCell\n" for id_ in (500, 501))
    code = "import sys; from rigctl.config import rig_file; rig_file.load(sys.argv[1])"
    file = write(RIG, DBC + twice)
    done = subprocess.run([sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_can_fd_is_refused_whatever_its_length(write: Write) -> None:
    frame_format = (
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved",'
        + ",".join('"reserved"' for _ in range(11))
        + ',"StandardCAN_FD","ExtendedCAN_FD";\nBA_ "VFrameFormat" BO_ 272 14;\n'
    )
    line = refusal(write(RIG, DBC + frame_format))
    number = line_of("tension_cell", "message")
    assert line == (
        f"FILE:{number}: {CELL}.message: found Tension with CAN FD, 5 bytes, expected a classic frame of 1 to 8 bytes"
    )


def test_a_cycle_time_that_is_no_number_is_refused(write: Write) -> None:
    dbc = DBC.replace("INT 0 65535", "STRING").replace('"GenMsgCycleTime" 0;', '"GenMsgCycleTime" "";')
    dbc = dbc.replace("BO_ 272 1;", 'BO_ 272 "often";').replace("BO_ 273 10;", 'BO_ 273 "10";')
    number = line_of("tension_cell", "message")
    assert refusal(write(RIG, dbc)) == (
        f"FILE:{number}: {CELL}.message: found Tension with a GenMsgCycleTime that is no number, expected milliseconds"
    )


def test_two_devices_cannot_share_a_message(write: Write) -> None:
    rig = RIG.replace("message: Inclination", "message: Tension")
    rig = (
        rig.replace("tangential: AngleTangential", "tangential: A")
        .replace("AngleNormal", "A")
        .replace("AngleValid", "A")
    )
    dbc = DBC.replace('"N" Controller\n', '"N" Controller\n SG_ A : 33|7@1+ (1,0) [0|0] "deg" Controller\n')
    number = line_of("inclinometer", "message")
    assert refusal(write(rig, dbc)) == (
        f"FILE:{number}: {SLOPE}.message: found Tension with id 0x110, expected an id of its own (tension_cell has it)"
    )


def test_node_ids_of_devices_with_plain_frames_are_free(write: Write) -> None:
    settings = config.load(write(changed(RIG, "  node: 4", "  node: 2"), DBC))
    assert settings.canopen_nodes == {"cylinder": 2}


@pytest.mark.parametrize("key", ["plain", "directory"])
def test_what_load_adds_may_not_stand_in_the_file(write: Write, key: str) -> None:
    assert refusal(write(RIG + f"{key}: x\n", DBC)).endswith(f"{key}: found an unknown key")


def test_check_shows_the_refusal_and_the_layout(write: Write, in_process: Command) -> None:
    good = in_process("rigctl", "check", write(RIG, DBC))
    assert good.returncode == 0
    assert "tension_cell: Tension, id 0x110, 5 bytes" in good.stdout
    file = write(RIG, DBC.replace('"N"', '"lbf"'))
    bad = in_process("rigctl", "check", file)
    assert bad.returncode == 2
    assert len(bad.stderr.splitlines()) == 1
    assert f"{file}:{line_of('tension_cell', 'tension')}: {CELL}.tension: found unit lbf, expected unit N" in bad.stderr


def test_bus_load_counts_plain_frames_at_their_cycle_time_or_the_loops_rate(write: Write) -> None:
    def rates(dbc: str) -> dict[str, float]:
        return {item.name: item.rate_hz for item in busload.traffic(config.load(write(RIG, dbc)))}

    found = rates(DBC.replace("BO_ 272 1;", "BO_ 272 2;"))
    assert found["tension (Tension)"] == 500.0
    assert found["inclination (Inclination)"] == 100.0
    assert found["heartbeats, devices"] == 10.0  # those of the drive alone
    found = rates(DBC.replace('BA_ "GenMsgCycleTime" BO_ 273 10;\n', ""))
    assert found["inclination (Inclination)"] == 1000.0


@run_with(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, len(DBC) - 1), cut=st.integers(0, 30), put=st.text(max_size=8))
def test_a_damaged_dbc_file_is_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, place: int, cut: int, put: str
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "eds").symlink_to(CONFIG / "eds")
    (folder / "rig.yaml").write_text(RIG)
    text = DBC[:place] + put + DBC[place + cut :]
    (folder / "plain_sensors.dbc").write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        config.load(folder / "rig.yaml")
    except config.ConfigError as error:
        (line,) = error.findings
        assert "\n" not in line


def test_what_a_terminal_cannot_show_is_quoted_in_its_escaped_form(write: Write) -> None:
    line = refusal(write(changed(RIG, "message: Inclination", 'message: "Incli\u2028nation"'), DBC))
    assert line.isprintable()
    assert "Incli\\u2028nation" in line
