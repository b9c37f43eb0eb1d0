"""What a section of the rig file may not hold: one line with its key, what was found and what is expected."""

from __future__ import annotations

import pathlib
import re

import pytest

from rigctl.config import rig_file as config
from tests.builders.paths import ROOT

REAL = (ROOT / "config/rig.yaml").read_text()
PAPER = (ROOT / "config/paper_rig.yaml").read_text()
FILTERED = "  filter_hz: 500.0               # of the amplifier"
LONG = REAL.replace("stroke_max_mm: 120.0", "stroke_max_mm: 300.0")
FAST = re.sub(r"speed_max_mm_s: [\d.]+", "speed_max_mm_s: 400.0", REAL)
STOCK = 'velocity_object: "0x606C", velocity_pdo: 3'
TWO = {"u_n": "0.1", "cell_u_n": "0.2", "disagree_n": "1.0", "kind": "cell"}


def cylinder(keys: str, text: str = REAL) -> str:
    """The rig file with these keys of the cylinder."""
    lines = "".join(f"  {key}\n" for key in keys.split(", "))
    return text.replace("cylinder: ", f"cylinder:\n{lines}  # ", 1)


def second_force(**keys: str) -> str:
    return f"{REAL}second_force: {{{', '.join(f'{key}: {value}' for key, value in (TWO | keys).items())}}}\n"


REFUSED = [
    (PAPER.replace(FILTERED, "  #"), "tension_cell.filter_hz", "found null, expected that of simulation.cell (500.0)"),
    (
        PAPER.replace(FILTERED, FILTERED.replace("500", "400")),
        "tension_cell.filter_hz",
        "found 400.0, expected that of",
    ),
    (f"{REAL}io: {{e_stop_input: 0, node: 4}}\n", "cylinder.node", "(io has it)"),
    (f"{REAL}io: {{e_stop_input: 0, node: 1}}\n", "io.node", "(can.controller_node has it)"),
    (f"{REAL}io: {{e_stop_input: 0, node: 112}}\n", "io.node", "(the simulator has it)"),
    (f"{REAL}io: {{e_stop_input: 0, node: 128}}\n", "io.node", "found 128, expected a whole number, 1 to 127"),
    (f"{REAL}io: {{e_stop_input: 64}}\n", "io.e_stop_input", "found 64, expected a whole number, 0 to 63"),
    (f"{REAL}io: {{e_stop_input: -1}}\n", "io.e_stop_input", "found -1"),
    (f"{REAL}io: {{node: 6}}\n", "io.e_stop_input", "found nothing"),
    (f"{REAL}io: {{e_stop_input: 0, eds: none.eds}}\n", "io.eds", "found no file none.eds, expected an EDS file"),
    (f"{REAL}io: {{e_stop_input: 0, event_ms: 40}}\n", "io.stale_ms", "found 100, expected 3 times event_ms (120)"),
    (f"{REAL}io: {{e_stop_input: 0, inhibit_ms: 21}}\n", "io.inhibit_ms", "found 21, expected at most event_ms (20)"),
    (f"{REAL}io: {{e_stop_input: 0, e_stop_imput: 1}}\n", "io.e_stop_imput", "e_stop_input?"),
    (cylinder('velocity_object: "0x6069"'), "cylinder.velocity_object", "found 0x6069, expected 0x2044 or 0x606C"),
    (cylinder('velocity_object: "0x60GC"'), "cylinder.velocity_object", "found '0x60GC'"),
    (
        cylinder('velocity_object: "0x606C"'),
        "cylinder.velocity_pdo",
        "another than position_pdo (1): status, position and 0x606C",
    ),
    (cylinder(STOCK.replace("3", "2")), "cylinder.status_pdo", "found 2, expected a PDO of its own"),
    (cylinder(STOCK.replace("3", "5")), "cylinder.velocity_pdo", "found 5, expected a whole number"),
    (cylinder("increments_per_mm: 10.0"), "cylinder.increments_per_mm", "found 10.0"),
    (cylinder("increments_per_mm: 1.0e+8"), "cylinder.increments_per_mm", "found 100000000.0"),
    (cylinder("increments_per_mm: 9.0e+6", LONG), "cylinder.increments_per_mm", "the stroke's end fits in 32 bits"),
    (cylinder("speed_units_per_mm_s: 10.0"), "cylinder.speed_units_per_mm_s", "found 10.0"),
    (
        cylinder("speed_units_per_mm_s: 6.0e+6, ramp_units_per_mm_s2: 10.0", FAST),
        "cylinder.speed_units_per_mm_s",
        "found 6000000.0, expected up to 5.36871e+06: tension.speed_max_mm_s fits",
    ),
    (
        cylinder("ramp_units_per_mm_s2: 9.0e+6"),
        "cylinder.ramp_units_per_mm_s2",
        "up to 8.58993e+06: stop_deceleration_mm_s2 fits",
    ),
    (cylinder("sdo_timeout_ms: 0"), "cylinder.sdo_timeout_ms", "found 0"),
    (cylinder('vendor: "0x1FFFFFFFF"'), "cylinder.vendor", "found '0x1FFFFFFFF'"),
    (cylinder("temperature_object: null"), "signal", "expected none of it: cylinder.temperature_object is null"),
    (second_force(disagree_n="0.2"), "second_force.disagree_n", "3 standard uncertainties"),
    (second_force(kind="stretch"), "second_force.spring_n_mm", "for stretch only"),
    (second_force(spring_n_mm="6"), "second_force.spring_n_mm", "for stretch only"),
    (second_force(rate_hz="300"), "second_force.rate_hz", "divided by 1 to 240"),
    (second_force(node="3"), "second_force.node", "a node id of its own"),
    (second_force(eds="none.eds"), "second_force.eds", "an EDS file"),
    (f"{REAL}page: {{listen: everywhere}}\n", "page.listen", "found everywhere, expected HOST:PORT"),
]


@pytest.mark.parametrize(("text", "key", "words"), REFUSED, ids=[f"{key}: {words}" for _, key, words in REFUSED])
def test_what_a_section_may_not_hold_is_refused_with_its_key(
    tmp_path: pathlib.Path, text: str, key: str, words: str
) -> None:
    (tmp_path / "eds").symlink_to(ROOT / "config/eds")
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with pytest.raises(config.ConfigError) as refused:
        config.load(file)
    (line,) = refused.value.findings
    assert f"{key}: " in line and words in line
