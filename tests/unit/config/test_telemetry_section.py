"""Where the daemon listens: other computers reach it with certificates, or by a waiver in words."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import pytest

from rigctl.config import rig_file as config
from tests.builders.daemons import rig_file, rigctl
from tests.conftest import Command

LOCAL = "expected a loopback address, tls/ with telemetry.tls, or telemetry.listen_waiver: why not, in words"
TLS = {"listen": "tls/0.0.0.0:7447", "tls": {"keys": "keys"}}
WAIVER = {"listen_waiver": "no other computer is on this network"}


@pytest.mark.parametrize(
    "telemetry",
    [
        {},
        {"listen": "tcp/localhost:7447"},
        {"listen": "tcp/127.1.2.3:7447"},
        {"listen": "tcp/[::1]:7447"},
        {"listen": "unixsock-stream//run/rigctl/rig.sock"},
        {"listen": "tcp/0.0.0.0:7447"} | WAIVER,
        {"join": ["tcp/192.168.1.10:7447"]} | WAIVER,
        TLS,
    ],
    ids=str,
)
def test_what_nobody_unknown_can_reach_is_taken(tmp_path: pathlib.Path, telemetry: dict[str, Any]) -> None:
    settings = config.load(rig_file(tmp_path, {"telemetry": telemetry}))
    assert settings.telemetry.listen_here == settings.telemetry.listen.replace("0.0.0.0", "127.0.0.1")
    assert settings.key_folder == (tmp_path / "keys" if "tls" in telemetry else None)


@pytest.mark.parametrize(
    ("telemetry", "expected"),
    [
        ({"listen": "tcp/0.0.0.0:7447"}, f"telemetry.listen: found tcp/0.0.0.0:7447, {LOCAL}"),
        ({"listen": "tcp/[::]:7447"}, LOCAL),
        ({"listen": "tcp/192.168.1.10:7447"}, LOCAL),
        ({"listen": "tcp/rig-pc:7447"}, LOCAL),
        (
            {"join": ["tcp/127.0.0.1:1", "tcp/192.168.1.10:7447"]},
            f"telemetry.join.1: found tcp/192.168.1.10:7447, {LOCAL}",
        ),
        ({"listen": "tcp/0.0.0.0:7447", "listen_waiver": "no"}, "telemetry.listen_waiver: found"),
        ({"listen": "quic/127.0.0.1:7447"}, "telemetry.listen: found 'quic/127.0.0.1:7447', expected"),
        ({"listen": "udp/127.0.0.1:7447"}, "telemetry.listen: found 'udp/127.0.0.1:7447', expected"),
        ({"listen": "tls/127.0.0.1:7447"}, "or a section telemetry.tls too"),
        ({"listen": f"unixsock-stream//tmp/{'ü' * 52}"}, "expected a socket's path of at most 107 bytes"),
        ({"tls": {"keys": "keys"}}, "expected tls/HOST:PORT, as there is a section telemetry.tls"),
        (TLS | WAIVER, "telemetry.listen_waiver: found"),
        (TLS | {"join": ["tcp/127.0.0.1:7448"]}, "telemetry.join: found"),
        (TLS | {"tls": {"keys": ""}}, "telemetry.tls.keys: found"),
        *(
            ({"join": join}, "telemetry.join")
            for join in (
                "tcp/192.168.1.10:7447",
                ["192.168.1.10:7447"],
                ["udp/192.168.1.10:7447"],
                ["unixsock-stream//run/z.sock"],
                [7447],
                ["tcp/a b"],
                None,
            )
        ),
        (TLS | {"listen": "tls/7447"}, "expected tls/HOST:PORT"),
        # Zenoh would take these as settings of the endpoint, over those of the daemon.
        (TLS | {"listen": "tls/0.0.0.0:7447#enable_mtls=false"}, "telemetry.listen: found"),
        ({"listen": "tcp/127.0.0.1:7447#bind=0.0.0.0:1"}, "telemetry.listen: found"),
    ],
)
def test_anything_else_is_refused_in_one_line(tmp_path: pathlib.Path, telemetry: dict[str, Any], expected: str) -> None:
    with pytest.raises(config.ConfigError) as refused:
        config.load(rig_file(tmp_path, {"telemetry": telemetry}))
    (line,) = refused.value.findings
    assert expected in line


def test_check_and_run_refuse_an_open_address_and_say_what_is_waived(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    reached = rig_file(tmp_path, {"telemetry": {"listen": "tcp/0.0.0.0:7447"}})
    for done in (in_process("rigctl", "check", reached), rigctl("run", str(reached))):
        assert done.returncode == 2 and LOCAL in done.stderr and done.stderr.count("\n") == 1
    waived = rig_file(tmp_path, {"telemetry": {"listen": "tcp/0.0.0.0:7447"} | WAIVER})
    words = "other computers reach tcp/0.0.0.0:7447, to read and to give HOLD, without certificates"
    assert words in " ".join(in_process("rigctl", "check", waived).stdout.split())
    assert words in json.loads(in_process("rigctl", "check", waived, "--json").stdout)["waived_listen"]


def test_run_refuses_a_key_folder_that_is_missing_or_open(tmp_path: pathlib.Path, in_process: Command) -> None:
    """Before anything is started."""
    file = rig_file(tmp_path, {"telemetry": {"listen": "tls/127.0.0.1:7447", "tls": {"keys": "keys"}}})
    missing = rigctl("run", str(file))
    assert missing.returncode == 2 and "make it with rigctl keys init" in missing.stderr
    assert in_process("rigctl", "keys", "init", "--dir", tmp_path / "keys").returncode == 0
    (tmp_path / "keys").chmod(0o755)
    opened = rigctl("run", str(file))
    assert opened.returncode == 2 and "found mode 0755, expected 0700" in opened.stderr
    assert opened.stderr.count("\n") == missing.stderr.count("\n") == 1
