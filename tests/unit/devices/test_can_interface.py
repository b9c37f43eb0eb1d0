"""Every interface of python-can without its hardware: opened, or one line with the cause, and nothing beside it."""

from __future__ import annotations

import logging
import subprocess
import sys

import can
import pytest

from rigctl.config.can_section import OWN, CanSettings
from rigctl.devices import can_interface
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

OTHERS = sorted(can.VALID_INTERFACES - OWN)
OPEN_ALL = """
import sys
from rigctl.config.can_section import CanSettings
from rigctl.devices import can_interface
for name in sys.argv[1:]:
    for channel in ("nothing here", "0"):
        try:
            can_interface.opened(CanSettings(interface=name, channel=channel, bitrate_bit_s=500_000)).shutdown()
            print(f"{name}: opened")
        except can_interface.OpenError as error:
            print(f"{name}: {error}")
"""


def settings(interface: str) -> CanSettings:
    return CanSettings(interface=interface, channel="0", bitrate_bit_s=500_000)


def test_each_is_opened_or_says_why_not_in_one_line_and_the_library_says_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-c", OPEN_ALL, *OTHERS], cwd=ROOT, capture_output=True, text=True, timeout=patience_s(),
        check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert [line.partition(": ")[0] for line in lines] == [name for name in OTHERS for _ in range(2)]
    assert all(line.partition(": ")[2] and line.isprintable() for line in lines)


def test_what_the_backend_only_logs_is_in_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver of PEAK and the like: the module is there, and its bus cannot be made."""

    def no_bus(**_: object) -> can.BusABC:
        logging.getLogger("can.a_backend").warning("The driver is\nnot loaded")
        logging.getLogger("can").warning("ABus was not properly shut down")
        raise NameError("name 'open_channel' is not defined")

    monkeypatch.setattr(can, "Bus", no_bus)
    with pytest.raises(can_interface.OpenError) as raised:
        can_interface.opened(settings("kvaser"))
    assert str(raised.value) == "name 'open_channel' is not defined (The driver is not loaded)"


def test_what_an_interface_lacks_is_found_before_it_is_opened() -> None:
    assert can_interface.lacking(settings("virtual")) == ""
    why = can_interface.lacking(settings("socketcand"))
    assert "'host'" in why and "~/.canrc" in why
    assert why.isprintable()
