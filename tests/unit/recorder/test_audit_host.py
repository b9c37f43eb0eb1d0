"""Heads of the audit log at a real collector: each entry's, in order; nothing waits for one that is away."""

from __future__ import annotations

import contextlib
import pathlib
import re
import socket
from collections.abc import Iterator

import pytest

from rigctl.config.audit_section import AuditSettings
from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.recorder.recorder_process import Recorder
from tests.builders.waiting import patience_s, until
from tests.unit.recorder.test_sources import entries

S = 1_000_000_000
MESSAGE = re.compile(
    r"<109>1 \d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z \S+ rigctl \d+ audit - "
    r"paper_rig entry (\d+) head ([0-9a-f]{64}) (.+)"
)


class Collector:
    """A syslog collector of one protocol at one port."""

    def __init__(self, protocol: str, port: int = 0) -> None:
        self.protocol = protocol
        self._socket = socket.socket(type=socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(patience_s())
        if protocol == "tcp":
            self._socket.listen()
        self.port = int(self._socket.getsockname()[1])
        self._connection: socket.socket | None = None
        self._came = b""

    @property
    def endpoint(self) -> str:
        return f"{self.protocol}/127.0.0.1:{self.port}"

    def line(self) -> str:
        """The next message."""
        if self.protocol == "udp":
            return self._socket.recv(65_536).decode().removesuffix("\n")
        if self._connection is None:
            self._connection, _ = self._socket.accept()
            self._connection.settimeout(patience_s())
        while b"\n" not in self._came:
            data = self._connection.recv(4096)
            assert data, "the recorder has closed the connection"
            self._came += data
        line, _, self._came = self._came.partition(b"\n")
        return line.decode()

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._socket.close()


@pytest.fixture(params=["tcp", "udp"])
def collector(request: pytest.FixtureRequest) -> Iterator[Collector]:
    with contextlib.closing(Collector(request.param)) as found:
        yield found


def sending_to(settings: RigSettings, endpoint: str) -> RigSettings:
    return settings.model_copy(update={"audit": settings.audit.model_copy(update={"syslog": endpoint})})


def test_each_entry_leaves_with_its_hash(runtime: Runtime, settings: RigSettings, collector: Collector) -> None:
    settings = sending_to(settings, collector.endpoint)
    recorder = Recorder(runtime, settings, 0, 0)
    events = runtime.events.writer()
    for second in range(1, 4):
        events.write(second * S, 9, 0, 0, 0.0, 0.0, b"a\nb")
        recorder.poll(second * S, second * S)
    recorder.close(4 * S, 4 * S)
    log = entries(settings)
    found = [MESSAGE.fullmatch(collector.line()) for _ in log]
    assert [int(one[1]) for one in found if one is not None] == [entry.n for entry in log]
    assert [one[2] for one in found if one is not None][:-1] == [entry.previous for entry in log[1:]]
    assert runtime.read_json(RECORDED)["head"] == (found[-1] or "")[2]
    assert runtime.read_json(RECORDED)["failures"] == 0


def test_a_collector_that_is_away_is_told_delays_nothing_and_gets_the_rest_when_it_is_back(
    runtime: Runtime, settings: RigSettings
) -> None:
    with contextlib.closing(Collector("tcp")) as there:
        port, endpoint = there.port, there.endpoint
    settings = sending_to(settings, endpoint)
    recorder = Recorder(runtime, settings, 0, 0)
    moment = iter(range(1, 100_000))

    def polled() -> None:
        now = next(moment) * S
        recorder.poll(now, now)

    def warned() -> bool:
        polled()
        return any(endpoint in line and "cannot be reached" in line for line in runtime.read_json(RECORDED)["warnings"])

    until(warned)
    assert [entry.what for entry in entries(settings)] == ["recorder_started"]  # on this computer the log goes on
    with contextlib.closing(Collector("tcp", port)) as back:
        first = MESSAGE.fullmatch(back.line())
        assert first is not None
        assert (first[1], first[3].split()[0]) == ("1", "recorder_started")

        def reported() -> bool:
            polled()
            return entries(settings)[-1].what == "written_again"

        until(reported)
        again = MESSAGE.fullmatch(back.line())
        assert again is not None
        assert again[2] == runtime.read_json(RECORDED)["head"]
        assert "the log's host could not be reached before" in again[3]
        recorder.close(200_000 * S, 200_000 * S)


@pytest.mark.parametrize("wrong", ["192.168.1.5:514", "tls/host:6514", "tcp/host", "udp/host:99999", "syslog/host:1"])
def test_another_endpoint_is_refused_in_one_line(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"tcp/HOST:PORT or udp/HOST:PORT"):
        AuditSettings(syslog=wrong)
    assert AuditSettings(syslog="udp/[::1]:514").syslog == "udp/[::1]:514"


def test_a_log_made_anew_is_found_by_a_head_that_the_collector_has(
    runtime: Runtime, settings: RigSettings, tmp_path: pathlib.Path
) -> None:
    """The other end of the way: ``rigctl audit verify --head``."""
    from rigctl.recorder.chain import verify

    with contextlib.closing(Collector("udp")) as collector:
        settings = sending_to(settings, collector.endpoint)
        recorder = Recorder(runtime, settings, 0, 0)
        recorder.poll(S, S)
        recorder.close(2 * S, 2 * S)
        heads = [found[2] for found in (MESSAGE.fullmatch(collector.line()) for _ in range(2)) if found]
    assert verify(settings.audit_log.read_bytes().splitlines(keepends=True), heads[-1]).good
    settings.audit_log.unlink()
    anew = Recorder(runtime, settings.model_copy(update={"directory": str(tmp_path)}), 3 * S, 3 * S)
    anew.close(4 * S, 4 * S)
    report = verify(settings.audit_log.read_bytes().splitlines(keepends=True), heads[-1])
    assert (report.good, "truncated: the head" in report.why) == (False, True)
