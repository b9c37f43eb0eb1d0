"""The table of objects that a start uses, held to what start-up reads and writes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

from hil.wire import FRAME
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings
from rigctl.devices import eds_file
from rigctl.devices import objects as od
from rigctl.devices.eds_file import EdsError
from rigctl.devices.needed_objects import needed
from rigctl.devices.process_data import wanted
from tests.builders.rig_bench import SETTINGS
from tests.builders.rig_on_hub import RigOnHub
from tests.unit.hil.test_parameter_sets import with_set

_SPECIFIERS = (0x40, 0x20)  # of the client: upload, download


class Asked(RigOnHub):
    """A rig that notes the objects of the requests to it, by node."""

    def __init__(self, settings: RigSettings) -> None:
        self.asked: set[tuple[int, int, int]] = set()
        super().__init__(settings)

    def take(self, frame: bytes) -> None:
        can_id, _, data = FRAME.unpack(frame)
        if can_id & ~0x7F == od.SDO_RX_BASE and data[0] & 0xE0 in _SPECIFIERS:
            index, sub = struct.unpack_from("<HB", data, 1)
            self.asked.add((can_id & 0x7F, index, sub))
        super().take(frame)


def fitted(**sections: Settings) -> RigSettings:
    return SETTINGS.model_copy(update=sections)


FORCE: dict[str, Any] = {"u_n": 1.0, "cell_u_n": 1.0, "disagree_n": 3.0}
RIGS: dict[str, Callable[[], RigSettings]] = {
    "paper": lambda: SETTINGS,
    "stock drive": lambda: with_set("stock_drive"),
    "increments": lambda: with_set("increments"),
    "as sold": lambda: with_set("as_sold"),
    "I/O node": lambda: fitted(io=IoSettings(e_stop_input=0)),
    "hard-wired enable": lambda: with_set("io_node"),
    "rail encoder": lambda: fitted(rail_encoder=RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=1000)),
    "second cell": lambda: fitted(second_force=SecondForceSettings(kind="cell", **FORCE)),
    "stretch": lambda: fitted(second_force=SecondForceSettings(kind="stretch", spring_n_mm=6.0, **FORCE)),
    "cell's temperature": lambda: fitted(
        compensation=CompensationSettings(temperature="cell", zero_n_k=0.02, zero_u_n_k=0.002)
    ),
}


@pytest.mark.parametrize("name", RIGS)
def test_start_up_asks_for_no_object_that_is_not_in_the_table_and_for_each_that_is_required(name: str) -> None:
    settings = RIGS[name]()
    rig = Asked(settings)
    rig.bring_up()
    data = wanted(settings)
    for section, node in settings.canopen_nodes.items():
        table = needed(settings, section)
        asked = {(index, sub) for id_, index, sub in rig.asked if id_ == node}
        assert asked <= table.keys(), section
        layouts = [x for key, x in data.frames.items() if data.owner(key, settings) == section]
        carried = {(index, sub) for layout in layouts for index, sub in layout.objects}
        carried |= {(layout.mapping_object, sub + 1) for layout in layouts for sub in range(len(layout.objects))}
        required = {at for at, need in table.items() if need.required}
        assert required - asked <= carried | {(od.CONTROLWORD, 0)}, section


def test_without_an_object_that_is_required_the_file_is_refused_by_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = eds_file._entry
    for section in SETTINGS.canopen_nodes:
        for at, need in needed(SETTINGS, section).items():

            def lacking(sections: Any, index: int, sub: int, *, divided: bool, at: Any = at) -> tuple[str, int] | None:
                return None if (index, sub) == at else entry(sections, index, sub, divided=divided)

            monkeypatch.setattr(eds_file, "_entry", lacking)
            if need.required:
                with pytest.raises(EdsError, match="found no object 0x{:04X}:{:02X},".format(*at)):
                    eds_file.read(SETTINGS, section)
            else:
                assert at not in eds_file.read(SETTINGS, section)
