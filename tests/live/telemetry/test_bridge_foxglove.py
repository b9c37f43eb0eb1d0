"""``rigctl bridge foxglove`` on a real gateway, with a client of its own and the SDK's server as the oracle."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import foxglove
import pytest
from foxglove.websocket import Capability, ServerListener
from websockets.exceptions import InvalidStatus

from rigctl.bridge import foxglove_protocol as protocol
from rigctl.model.states import Mode
from tests.builders.foxglove_client import FoxgloveClient, stalled
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

OTHER = "https://studio.example"


class Bridge:
    """The command in a process of its own."""

    def __init__(self, daemon: Daemon, *options: str) -> None:
        command = [sys.executable, "-m", "rigctl", "bridge", "foxglove", "--listen", "127.0.0.1:0", *options]
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=daemon.environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.line = self.process.stdout.readline()
        found = re.match(r"foxglove: ws://127\.0\.0\.1:(\d+), paper_rig at ", self.line)
        assert found, self.line
        self.port = int(found[1])

    def end(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGTERM)
        _, said = self.process.communicate(timeout=patience_s())
        return self.process.returncode, said


@contextlib.contextmanager
def bridge(daemon: Daemon, *options: str) -> Iterator[Bridge]:
    found = Bridge(daemon, *options)
    try:
        yield found
    except BaseException as error:
        if (code := found.process.poll()) is not None:
            error.add_note(f"the bridge had ended with {code}: {found.process.communicate()[1]}")
        raise
    finally:
        if found.process.poll() is None:
            found.process.kill()
            found.process.communicate()


@pytest.fixture(scope="module")
def full(shared: Daemon) -> Iterator[Bridge]:
    """Every tick of the shared daemon."""
    with bridge(shared, "--rate", "1000", "--origin", OTHER) as found:
        yield found


@pytest.mark.parametrize("name", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_every_record_comes_whole_and_in_order_under_both_names(full: Bridge, shared: Daemon, name: str) -> None:
    before_ns = time.time_ns()
    with FoxgloveClient(full.port, name) as client, shared.rig() as rig:
        assert client.socket.subprotocol == name
        assert client.info["name"] == "paper_rig"
        client.subscribe("/records", 7)
        found = [client.message() for _ in range(1500)]
        fields = set(rig.fields)
    records = [record for _, _, record in found]
    assert {number for number, _, _ in found} == {7}
    first = records[0].seq
    assert [record.seq for record in records] == list(range(first, first + 1500))
    assert {row.name for row in records[0].DESCRIPTOR.fields} == fields
    offsets = [wall_ns - record.t_ns for _, wall_ns, record in found]
    assert max(offsets) - min(offsets) < 1e9  # of the wall clock, as each state says it
    assert before_ns - 30e9 < found[0][1] < time.time_ns()


def test_modes_and_qualities_are_enumerations(full: Bridge) -> None:
    with FoxgloveClient(full.port) as client:
        client.subscribe("/records", 1)
        record = client.messages(1)[0]
    kinds = {row.name: row.enum_type for row in record.DESCRIPTOR.fields if row.enum_type is not None}
    names = kinds["mode"].values_by_number
    assert {number: names[number].name for number in names} == {mode: f"MODE_{mode.name}" for mode in Mode}
    assert names[record.mode].name == "MODE_DISARMED"
    assert {"fault", "tension_quality", "tension_verdict"} <= kinds.keys()
    assert kinds["inclination_quality"].values_by_number[record.inclination_quality].name == "QUALITY_STALE"


def test_records_come_at_the_rate_asked(shared: Daemon) -> None:
    with bridge(shared, "--rate", "100") as slow, FoxgloveClient(slow.port) as client:
        client.subscribe("/records", 1)
        numbers = [record.seq for record in client.messages(50)]
    assert {b - a for a, b in itertools.pairwise(numbers)} == {10}


def test_events_and_states_come_as_they_happen(own: Daemon) -> None:
    with bridge(own) as served, FoxgloveClient(served.port) as client, own.rig() as rig:
        for number, topic in enumerate(("/events", "/log", "/state", "/bridge"), 1):
            client.subscribe(topic, number)
        until(lambda: client.message()[0] == 3, "a state")
        assert rig.command("arm", operator="kim")["accepted"]
        seen: dict[int, list[dict[str, object]]] = {1: [], 2: [], 3: [], 4: []}

        def armed() -> bool:
            number, _, content = client.message()
            seen[number].append(content)
            modes = [event for event in seen[1] if event["kind"] == "MODE"]
            return bool(modes and seen[4]) and len(seen[1]) == len(seen[2]) and seen[3][-1]["mode"] == "HOLD"

        until(armed, "the change of mode")
    assert [line["message"] for line in seen[2]] == [event["text"] for event in seen[1]]
    assert {line["level"] for line in seen[2]} <= {2, 3, 4}
    assert seen[4][-1]["lost"] == 0
    assert seen[4][-1]["clients"] == 1


def test_parameters_are_the_rigs_settings_and_cannot_be_set(full: Bridge, shared: Daemon) -> None:
    with FoxgloveClient(full.port) as client:
        assert "parameters" in client.info["capabilities"]
        client.send(op="getParameters", parameterNames=[], id="all")
        answer = client.told("parameterValues")
        found = {one["name"]: one["value"] for one in answer["parameters"]}
        assert answer["id"] == "all"
        assert found["plant.radius_mm"] == shared.settings.plant.radius_mm
        assert found["rig"] == "paper_rig"
        assert len(found) > 60
        client.send(op="setParameters", parameters=[{"name": "plant.radius_mm", "value": 1.0}], id="set")
        assert "read-only" in client.told("status")["message"]
        assert {one["name"]: one["value"] for one in client.told("parameterValues")["parameters"]} == found


NO_REQUESTS = (
    "", "{", '{"op":"advertise"}', '{"op":"subscribe","subscriptions":[{"id":-1}]}',
    '{"op":"subscribe","subscriptions":[{"id":1,"channelId":99}]}', b"\x01\x02",
)  # fmt: skip


@pytest.mark.parametrize("request_", NO_REQUESTS)
def test_a_request_that_is_none_is_one_line_and_the_client_stays(full: Bridge, request_: str | bytes) -> None:
    with FoxgloveClient(full.port) as client:
        client.socket.send(request_)
        told = client.told("status")
        assert told["level"] == 2
        assert "\n" not in told["message"]
        client.subscribe("/records", 1)
        assert client.messages(1)


def test_pages_of_elsewhere_and_unknown_protocols_are_refused(full: Bridge) -> None:
    for origin in (OTHER, "http://localhost:8080"):
        with FoxgloveClient(full.port, origin=origin):
            pass
    for origin in ("https://elsewhere.example", "file://", "null", "http://localhost.elsewhere.example"):
        with pytest.raises(InvalidStatus, match="403"), FoxgloveClient(full.port, origin=origin):
            pass
    for host in ("elsewhere.example", "192.0.2.1:8765"):  # a name made to point here (DNS rebinding)
        with pytest.raises(InvalidStatus, match="421"), FoxgloveClient(full.port, host=host):
            pass
    with pytest.raises(InvalidStatus, match="400"), FoxgloveClient(full.port, name="another"):
        pass


def test_a_stalled_client_is_dropped_and_counted_and_the_others_lose_nothing(shared: Daemon) -> None:
    with bridge(shared, "--rate", "1000") as served, FoxgloveClient(served.port) as client:
        client.subscribe("/records", 1)
        client.subscribe("/bridge", 2)
        numbers, dropped = [], 0
        with stalled(served.port, client.channels["/records"]["id"], 5):
            end = time.monotonic() + patience_s()
            while not dropped and time.monotonic() < end:
                number, _, content = client.message()
                if number == 1:
                    numbers.append(content.seq)
                else:
                    dropped = content["dropped_clients"]
                    assert content["lost"] == 0
        assert dropped == 1
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        code, said = served.end()
    assert code == 0
    assert re.search(r"^bridge: client 127\.0\.0\.1:\d+ was disconnected: more than 4 MiB untaken$", said, re.MULTILINE)


@pytest.mark.parametrize(("away_s", "pause_s", "count"), [(0.0, 0.0, 4000), (9.0, 2.0, 13000)])
def test_it_goes_on_with_the_next_gateway(own: Daemon, away_s: float, pause_s: float, count: int) -> None:
    """After 9 s it catches up with more than a client may leave untaken; a client that pauses meanwhile stays."""
    with bridge(own, "--rate", "1000") as served, FoxgloveClient(served.port) as client:
        client.subscribe("/records", 1)
        first = client.messages(100)[-1].seq
        own.kill_gateway()
        time.sleep(away_s)
        own.start_gateway()
        time.sleep(pause_s)
        numbers = [record.seq for record in client.messages(count)]
    assert numbers == list(range(first + 1, first + count + 1))


def test_json_of_the_state_schema_is_read_by_lichtblick(full: Bridge) -> None:
    """Its reader knows plain types, and arrays and objects that say what is in them."""
    with FoxgloveClient(full.port) as client:
        for topic in ("/state", "/events", "/log", "/bridge"):
            for name, row in json.loads(client.channels[topic]["schema"])["properties"].items():
                assert row["type"] in ("string", "number", "integer", "boolean", "object", "array"), name
                assert "items" in row or row["type"] != "array", name
                assert "properties" in row or row["type"] != "object", name


# -- the SDK's own server as the oracle ----------------------------------------------------------------------------
def test_our_server_says_what_the_sdks_server_says(full: Bridge) -> None:
    """The same client, the same channels: the same keys, and the same bytes of a message."""
    with FoxgloveClient(full.port) as ours:
        mine, offered = ours.info, ours.channels["/records"]
    context = foxglove.Context()
    parameters = [foxglove.Parameter("plant.radius_mm", value=750.0), foxglove.Parameter("rig", value="paper_rig")]

    class Listener(ServerListener):
        def on_get_parameters(self, client: object, names: list[str], request_id: str | None = None) -> list[Any]:  # noqa: ARG002
            return parameters

    server = foxglove.start_server(
        port=0, context=context, capabilities=[Capability.Parameters], session_id="one", server_listener=Listener()
    )
    try:
        schema = foxglove.Schema(name="rigctl.Record", encoding="protobuf", data=base64.b64decode(offered["schema"]))
        records = foxglove.Channel("/records", message_encoding="protobuf", schema=schema, context=context)
        foxglove.Channel("/bridge", message_encoding="json", context=context)
        with FoxgloveClient(server.port, "foxglove.sdk.v1") as client:
            theirs = client.channels["/records"]
            assert mine.keys() >= client.info.keys()
            assert mine["capabilities"] == client.info["capabilities"]
            assert {name: offered[name] for name in theirs if name != "id"} == {
                name: value for name, value in theirs.items() if name != "id"
            }
            client.send(op="getParameters", parameterNames=[], id="q")
            assert client.told("parameterValues") == json.loads(
                protocol.parameter_values({"plant.radius_mm": 750.0, "rig": "paper_rig"}, "q")
            )
            client.subscribe("/records", 5)
            until(records.base.has_sinks, "the subscription")
            records.log(b"\x08\x01", log_time=123456789)
            assert client.raw() == protocol.message_data(5, 123456789, b"\x08\x01")
    finally:
        server.stop()
