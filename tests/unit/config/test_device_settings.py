"""Settings of commercial devices: read exactly, or refused in one line with the expected value."""

from __future__ import annotations

import pathlib
import re

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.demo.live_rig import rig_file
from tests.builders.paths import ROOT
from tests.unit.hil.test_parameter_sets import with_set

REAL = (ROOT / "config/rig.yaml").read_text()
STOCK = '  velocity_object: "0x606C"\n  velocity_pdo: 3\n'


def load(folder: pathlib.Path, cylinder: str, text: str = REAL) -> RigSettings:
    (folder / "eds").symlink_to(ROOT / "config/eds")
    file = folder / "rig.yaml"
    file.write_text(text.replace("cylinder: ", f"cylinder:\n{cylinder}  # ", 1))
    return config.load(file)


def test_a_number_of_a_data_sheet_is_given_in_hexadecimal(tmp_path: pathlib.Path) -> None:
    cylinder = load(tmp_path, STOCK + '  vendor: "0x1A"\n  product: 1027\n').cylinder
    assert (cylinder.velocity_object, cylinder.vendor, cylinder.product) == (0x606C, 0x1A, 0x403)


@pytest.mark.parametrize(
    ("cylinder", "key", "words"),
    [
        ('  velocity_object: "0x6069"\n', "velocity_object", "found 0x6069, expected 0x2044 or 0x606C"),
        ('  velocity_object: "0x60GC"\n', "velocity_object", "found '0x60GC'"),
        ('  velocity_object: "0x606C"\n', "velocity_pdo", "another than position_pdo (1): status, position and 0x606C"),
        (STOCK.replace("3", "2"), "status_pdo", "found 2, expected a PDO of its own"),
        (STOCK.replace("3", "5"), "velocity_pdo", "found 5, expected a whole number"),
        ("  increments_per_mm: 10.0\n", "increments_per_mm", "found 10.0"),
        ("  increments_per_mm: 1.0e+8\n", "increments_per_mm", "found 100000000.0"),
        ("  speed_units_per_mm_s: 10.0\n", "speed_units_per_mm_s", "found 10.0"),
        ("  ramp_units_per_mm_s2: 9.0e+6\n", "ramp_units_per_mm_s2", "up to 8.58993e+06: stop_deceleration_mm_s2 fits"),
        ("  sdo_timeout_ms: 0\n", "sdo_timeout_ms", "found 0"),
        ('  vendor: "0x1FFFFFFFF"\n', "vendor", "found '0x1FFFFFFFF'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path: pathlib.Path, cylinder: str, key: str, words: str) -> None:
    with pytest.raises(config.ConfigError) as refused:
        load(tmp_path, cylinder)
    (line,) = refused.value.findings
    assert f" cylinder.{key}: " in line and words in line


def test_a_limit_on_a_temperature_the_drive_does_not_tell_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(config.ConfigError) as refused:
        load(tmp_path, "  temperature_object: null\n")
    (line,) = refused.value.findings
    assert ".signal: found drive_temperature_c, expected none of it: cylinder.temperature_object is null" in line


def test_increments_that_do_not_fit_in_32_bits_are_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(config.ConfigError) as refused:
        load(tmp_path, "  increments_per_mm: 9.0e+6\n", REAL.replace("stroke_max_mm: 120.0", "stroke_max_mm: 300.0"))
    assert any("up to 7.15828e+06: the stroke's end fits in 32 bits" in line for line in refused.value.findings)


def test_a_speed_that_does_not_fit_in_32_bits_is_refused(tmp_path: pathlib.Path) -> None:
    fast = re.sub(r"speed_max_mm_s: [\d.]+", "speed_max_mm_s: 400.0", REAL)
    units = "  speed_units_per_mm_s: 6.0e+6\n  ramp_units_per_mm_s2: 10.0\n"
    with pytest.raises(config.ConfigError) as refused:
        load(tmp_path, units, fast)
    words = "cylinder.speed_units_per_mm_s: found 6000000.0, expected up to 5.36871e+06: tension.speed_max_mm_s fits"
    assert any(words in line for line in refused.value.findings)


def test_a_rig_file_written_for_a_demo_is_read_back_the_same(tmp_path: pathlib.Path) -> None:
    settings = with_set("as_sold")
    again = config.load(rig_file(settings, tmp_path))
    assert again.model_dump(exclude={"directory"})["can"] == settings.model_dump(exclude={"directory"})["can"]
    assert again.cylinder.model_dump(exclude={"eds"}) == settings.cylinder.model_dump(exclude={"eds"})
    assert again.start_up_limit_s == 15.0 + 3 * 100 * 1.0
