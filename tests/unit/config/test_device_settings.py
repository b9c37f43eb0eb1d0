"""Settings of commercial devices: read exactly, or refused in one line with the expected value."""

from __future__ import annotations

import pathlib

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


def test_a_rig_file_written_for_a_demo_is_read_back_the_same(tmp_path: pathlib.Path) -> None:
    settings = with_set("as_sold")
    again = config.load(rig_file(settings, tmp_path))
    assert again.model_dump(exclude={"directory"})["can"] == settings.model_dump(exclude={"directory"})["can"]
    assert again.cylinder.model_dump(exclude={"eds"}) == settings.cylinder.model_dump(exclude={"eds"})
    assert again.start_up_limit_s == 15.0 + 3 * 100 * 1.0
