"""EDS and DBC files as the field has them: what ``rigctl check`` passes, a start can use, and no value in it is cut.

Each mutant is one change of a kind that users of other projects have reported. The served rig keeps the original
files, so a file that is passed must bring the same rig up with the same values. cantools is the oracle of a DBC file.
"""

from __future__ import annotations

import codecs
import logging
import math
import pathlib
import random
import shutil
import tempfile
from typing import Any

import cantools

from rigctl.config import rig_file as config
from rigctl.config.plain import PlainMessage
from rigctl.config.rig_file import ConfigError
from rigctl.config.settings import RigSettings
from rigctl.devices import dbc, eds_file
from rigctl.devices.eds_file import EdsError
from rigctl.devices.remote_node import StartupError
from rigctl.devices.startup import StartupReport
from tests.builders.paths import ROOT
from tests.builders.rig_bench import changed
from tests.builders.rig_on_hub import RigOnHub
from tests.fuzz import dbc_mutants, eds_mutants
from tests.fuzz.judge import Tally

_PER_MM = 209_715.2  # of the stock drive: by its feed constant as by encoder and gear
_PAYLOADS = 20
_RELATIVE = 1e-9  # between our decoder and cantools, which multiplies in another order


def play_eds(count: int, seed: int, tally: Tally) -> None:
    """``count`` mutants of the EDS files of the paper's rig and of a stock drive, each checked and started."""
    chance = random.Random(seed)
    paper = config.load(ROOT / "config/paper_rig.yaml")
    stock = changed(
        paper,
        cylinder={
            "eds": "eds/stock_drive.eds", "velocity_object": 0x606C, "velocity_pdo": 3, "temperature_object": None,
            "lead_mm": 5.0, "increments_per_mm": _PER_MM,
        },
        simulation={"drive": {"increments_per_mm": _PER_MM}},
    )  # fmt: skip
    wanted = {id(rig): RigOnHub(rig).bring_up() for rig in (paper, stock)}
    with tempfile.TemporaryDirectory(prefix="rigctl-fuzz-", dir="/dev/shm") as folder:
        for i in range(count):
            rig, device = chance.choice(((paper, "tension_cell"), (paper, "inclinometer"), (paper, "cylinder"),
                                         (stock, "cylinder")))  # fmt: skip
            change = eds_mutants.CHANGES[i % len(eds_mutants.CHANGES)]
            section = getattr(rig, device)
            text = change(eds_mutants.sections(rig.file(section.eds).read_text()), chance)
            file = pathlib.Path(folder) / f"mutant_{i}.eds"
            file.write_bytes(text if isinstance(text, bytes) else eds_mutants.joined(text).encode())
            mutant = rig.model_copy(update={device: section.model_copy(update={"eds": str(file)})})
            _judge_eds(f"EDS: {change.__name__[1:]}", f" ({device}, mutant {i})", rig, mutant, wanted[id(rig)], tally)


def _judge_eds(
    name: str, which: str, rig: RigSettings, mutant: RigSettings, wanted: StartupReport, tally: Tally
) -> None:
    checked = tally.attempt(name, which.encode(), lambda: eds_file.check(mutant), (EdsError,))
    served = RigOnHub(rig)
    served.settings = mutant
    report = tally.attempt("EDS: start", (name + which).encode(), served.bring_up, (StartupError,))
    if checked is None:
        if report is not None:
            tally.wrong.append(f"{name}{which}: refused by check, and it starts")
        return
    if not isinstance(report, StartupReport):
        tally.wrong.append(f"{name}{which}: passed by check, and it does not start")
        return
    if report.process_data != wanted.process_data:
        tally.wrong.append(f"{name}{which}: other process data: {report.process_data}")
    devices = {node.id: node.device for node in served.rig.nodes}
    for item in report.watched:
        data = devices[item.node].get_data(item.index, item.sub)
        if (len(data), int.from_bytes(data, "little")) != (item.size, item.wanted):
            tally.wrong.append(f"{name}{which}: {item}, and the device has {data.hex(' ')}")


def play_dbc(count: int, seed: int, tally: Tally) -> None:
    """``count`` mutants of the plain rig's DBC file, each read as ``check`` and ``run`` read it."""
    chance = random.Random(seed)
    kinds = list(dbc_mutants.CHANGES)
    with tempfile.TemporaryDirectory(prefix="rigctl-fuzz-", dir="/dev/shm") as name:
        folder = pathlib.Path(name) / "config"
        shutil.copytree(ROOT / "config", folder, ignore=shutil.ignore_patterns("calibration", "audit"))
        rig, file = folder / "plain_rig.yaml", folder / "plain_sensors.dbc"
        text = file.read_text()
        for i in range(count):
            kind = kinds[i % len(kinds)]
            mutant = dbc_mutants.CHANGES[kind](text, chance)
            file.write_bytes(mutant if isinstance(mutant, bytes) else mutant.encode())
            _judge_dbc(f"DBC: {kind}", rig, file, chance, tally)


def _judge_dbc(name: str, rig: pathlib.Path, file: pathlib.Path, chance: random.Random, tally: Tally) -> None:
    found = tally.attempt(name, file.read_bytes()[:300], lambda: config.load(rig), (ConfigError,), line=False)
    if not isinstance(found, RigSettings):
        return
    encoding = "utf-16" if file.read_bytes().startswith(codecs.BOM_UTF16_LE) else "utf-8-sig"
    database = cantools.database.load_file(str(file), database_format="dbc", encoding=encoding)
    cell, slope = found.plain_messages["tension_cell"], found.plain_messages["inclinometer"]
    decoders = {"tension_cell": dbc.tension_decoder(cell), "inclinometer": dbc.inclination_decoder(slope)}
    for device, message in found.plain_messages.items():
        known = next(each for each in database.messages if each.name == message.name)
        for _ in range(_PAYLOADS):
            data = chance.randbytes(message.size)
            values = known.decode(data, decode_choices=False)
            ours = decoders[device](data)
            for (role, signal), value in zip(message.signals.items(), ours, strict=False):
                if role != "valid" and not _same(value, _in_si(known, signal.name, values[signal.name])):
                    tally.wrong.append(
                        f"{name}: {signal.name}: {value} of {data.hex()}, cantools {values[signal.name]}"
                    )
    for row in _never_reached(found, database):
        tally.wrong.append(f"{name}: {row} can never trip")


def _in_si(message: Any, signal: str, value: Any) -> float:
    return float(value) * (math.radians(1.0) if message.get_signal_by_name(signal).unit == "deg" else 1.0)


def _same(ours: float, theirs: float) -> bool:
    if not (math.isfinite(ours) and math.isfinite(theirs)):
        return True  # no number: the decoder marks it, see tests/unit/devices/test_dbc.py
    return abs(ours - theirs) <= _RELATIVE * max(1.0, abs(theirs))


def _never_reached(rig: RigSettings, database: Any) -> list[str]:
    """Limits beyond the values that a frame can carry, by cantools."""
    names: dict[str, tuple[PlainMessage, str, float]] = {
        "tangential_deg": (rig.plain_messages["inclinometer"], "tangential", math.degrees(1.0)),
        "normal_deg": (rig.plain_messages["inclinometer"], "normal", math.degrees(1.0)),
        "tension_n": (rig.plain_messages["tension_cell"], "tension", 1.0),
    }
    bounds = [(row.signal, row.low, row.high) for row in rig.limits if row.signal in names and row.action != "log"]
    bounds.append(("tension_n", rig.safety.tension_low_n, rig.safety.tension_high_n))
    found = []
    for signal, low, high in bounds:
        message, role, factor = names[signal]
        known = next(each for each in database.messages if each.name == message.name)
        least, most = _span(known, message.signals[role].name, factor)
        if high is not None and most <= high:
            found.append(f"{signal} above {high:g} (the frame ends at {most:g})")
        if low is not None and least >= low:
            found.append(f"{signal} below {low:g} (the frame begins at {least:g})")
    return found


def _span(message: Any, name: str, factor: float) -> tuple[float, float]:
    """Least and largest value that the signal's bits can carry."""
    signal = message.get_signal_by_name(name)
    if signal.is_float:
        return -math.inf, math.inf
    bits = signal.length
    raw = (-(1 << bits - 1), (1 << bits - 1) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    ends = [_in_si(message, name, end * float(signal.scale) + float(signal.offset)) * factor for end in raw]
    return min(ends), max(ends)


def play(count: int, seed: int) -> Tally:
    """``count`` mutants of each format."""
    tally = Tally()
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    play_eds(count, seed, tally)
    play_dbc(count, seed, tally)
    return tally
