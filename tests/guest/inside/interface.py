"""Runs in the guest only: systemd-networkd brings a CAN interface up from the files that `rigctl install` writes."""

from __future__ import annotations

import json
import pathlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from tests.builders.paths import ROOT
from tests.builders.waiting import until
from tests.guest.inside.guest_rig import BUS

NETWORKD = "/lib/systemd/systemd-networkd"
CONFIGURED = pathlib.Path("/run/systemd/network")


@pytest.fixture
def interface() -> Iterator[str]:
    """An adapter that has just been plugged in: its interface is there, down, without a bit rate."""
    program = str(pathlib.Path(__file__).with_name("adapter.py"))
    adapter = subprocess.Popen([sys.executable, program, BUS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert adapter.stdout is not None
    yield adapter.stdout.readline().strip()
    adapter.communicate()


def shown(interface: str) -> dict[str, Any]:
    words = ["/sbin/ip", "-j", "-d", "link", "show", interface]
    found: dict[str, Any] = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)[0]
    return found


def test_the_interface_comes_up_with_the_rig_files_bit_rate(interface: str, tmp_path: pathlib.Path) -> None:
    assert "UP" not in shown(interface)["flags"]
    data = yaml.safe_load((ROOT / "config/rig.yaml").read_text())
    data["can"] |= {"channel": interface, "bitrate_bit_s": 800000}
    data["loop"]["cpu"] = None
    shutil.copytree(ROOT / "config/eds", tmp_path / "eds")
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    root = tmp_path / "root"
    words = ["-m", "rigctl", "install", str(tmp_path / "rig.yaml"), "--root", str(root)]
    subprocess.run([sys.executable, *words], check=True, cwd=ROOT)
    shutil.copytree(root / "etc/systemd/network", CONFIGURED)
    for folder in ("netif", "netif/links"):  # as the unit's RuntimeDirectory: networkd gives up root before it writes
        (CONFIGURED.parent / folder).mkdir()
        shutil.chown(CONFIGURED.parent / folder, "systemd-network", "systemd-network")
    subprocess.run(["mount", "-o", "remount,ro", "/sys"], check=True)  # there is no udev to wait for
    log = tmp_path / "networkd.log"
    with log.open("wb") as out:
        networkd = subprocess.Popen([NETWORKD], stdout=out, stderr=out, env={"SYSTEMD_LOG_LEVEL": "debug"})
    try:
        until(lambda: "UP" in shown(interface)["flags"], log=log)
        waited = ["/lib/systemd/systemd-networkd-wait-online", f"--interface={interface}:carrier", "--timeout=60"]
        online = subprocess.run(waited, check=False)
        assert online.returncode == 0, log.read_text(errors="replace")[-4000:]
    finally:
        networkd.terminate()
        networkd.wait()
    controller = shown(interface)["linkinfo"]["info_data"]
    assert controller["bittiming_bitrate"] == 800000, controller  # a controller with a few fixed rates
    assert controller.get("restart_ms", 0) == 0
