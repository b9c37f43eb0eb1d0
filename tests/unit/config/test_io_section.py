"""The `io` section: read exactly or refused in one line; its frames in the check of the rig file."""

from __future__ import annotations

import io as streams
import pathlib

import pytest
from rich.console import Console

from rigctl.cli import check
from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.settings import RigSettings
from rigctl.demo.live_rig import rig_file
from rigctl.devices import busload
from tests.builders.paths import ROOT

REAL = (ROOT / "config/rig.yaml").read_text()
SECTION = "io: {e_stop_input: 0}\n"


def load(folder: pathlib.Path, section: str, text: str = REAL) -> RigSettings:
    (folder / "eds").symlink_to(ROOT / "config/eds")
    file = folder / "rig.yaml"
    file.write_text(text + section)
    return config.load(file)


def test_no_rig_has_an_io_node_unless_it_says_so(tmp_path: pathlib.Path) -> None:
    for name in ("rig.yaml", "paper_rig.yaml", "plain_rig.yaml"):
        settings = config.load(ROOT / "config" / name)
        assert settings.io is None
        assert "io" not in settings.canopen_nodes
    settings = load(tmp_path, SECTION)
    assert settings.canopen_nodes["io"] == 6
    assert settings.io is not None
    assert (settings.io.event_ms, settings.io.inhibit_ms, settings.io.stale_ms) == (20, 5, 100)


@pytest.mark.parametrize(("number", "block", "mask"), [(0, 1, 1), (7, 1, 0x80), (8, 2, 1), (63, 8, 0x80)])
def test_an_input_has_its_sub_index_and_bit(number: int, block: int, mask: int) -> None:
    settings = IoSettings(e_stop_input=number)
    assert (settings.block, settings.mask) == (block, mask)


def test_an_input_may_not_be_stale_within_two_periods_of_a_slow_loop(tmp_path: pathlib.Path) -> None:
    settings = load(tmp_path, "io: {e_stop_input: 0, event_ms: 5, stale_ms: 15}\n").model_dump(exclude={"plain"})
    slow = {**settings, "loop": {**settings["loop"], "rate_hz": 100}}
    slow["safety"] = {**settings["safety"], "stale_ms": 40, "bus_silent_ms": 40}
    slow["cylinder"] = {**settings["cylinder"], "status_rate_hz": 20}
    with pytest.raises(ValueError, match=r"event_ms and two loop periods \(25\) or more"):
        RigSettings.model_validate(slow)


def test_the_bus_load_counts_the_node_at_its_inhibit_time_with_its_heartbeat(tmp_path: pathlib.Path) -> None:
    before = config.load(ROOT / "config/rig.yaml")
    after = load(tmp_path, "io: {e_stop_input: 0, inhibit_ms: 4}\n")
    loads = [busload.bus_load(settings) for settings in (before, after)]
    assert loads[0] is not None and loads[1] is not None
    assert loads[1] - loads[0] == pytest.approx((250 + 10) * 65 / 1e6)  # 1 byte: 65 bits, inputs and heartbeats
    out = streams.StringIO()
    check.show(after, Console(file=out, width=120))
    assert "I/O inputs" in out.getvalue()
    assert "E_STOP_UNSEEN" in out.getvalue()
    assert "e_stop_input" in out.getvalue()


def test_a_bus_that_cannot_carry_the_node_is_refused(tmp_path: pathlib.Path) -> None:
    text = REAL.replace("bitrate_bit_s: 1000000", "bitrate_bit_s: 550000")
    assert text != REAL
    assert not check.accepted(load(tmp_path, "io: {e_stop_input: 0, inhibit_ms: 1}\n", text))


def test_a_rehearsal_takes_the_eds_files_of_every_node_along(tmp_path: pathlib.Path) -> None:
    encoder = RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=1000)
    paper = config.load(ROOT / "config/paper_rig.yaml")
    fitted = paper.model_copy(update={"io": IoSettings(e_stop_input=0), "rail_encoder": encoder})
    for settings in (paper, fitted):
        assert config.load(rig_file(settings, tmp_path)).canopen_nodes == settings.canopen_nodes
