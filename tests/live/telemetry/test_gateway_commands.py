"""Commands over real sessions: carried out, refused with the reason, and several at once."""

from __future__ import annotations

import contextlib
import pathlib
from collections.abc import Iterator

import pytest
import zenoh

from rigctl.client.connection import Client, NoDaemonError
from rigctl.model.checks import Check
from rigctl.model.verbs import Setting, Verb
from tests.builders.miniature import RUN_ID, Daemon, running
from tests.builders.operators import KIM
from tests.builders.waiting import patience_s, until


@pytest.fixture(scope="module")
def refusing() -> Iterator[Daemon]:
    yield from running("--fail-preflight")


def test_a_session_with_the_rig(own: Daemon) -> None:
    with own.client() as client:
        refused = client.command("tension", "kim")
        assert refused["accepted"] is False
        assert refused["reason"] == "wrong_mode"
        assert refused["text"] == "TENSION refused: tension is not possible in DISARMED: arm first"
        armed = client.command("arm", "kim")
        assert armed["accepted"] is True
        words = "simulated cell: there is no weight to hang on it"
        assert armed["text"] == f"ARM: armed, HOLD, stroke 0.00 mm, tension 0.0 N; waived: calibration, tare ({words})"
        assert armed["waived"] == {"calibration": words, "tare": words}
        assert (armed["mode"], armed["operator"]) == ("HOLD", KIM)
        assert client.command("target", "kim", 400.0)["text"] == "TARGET refused: target must be 50 to 350 N"
        assert client.command("target", "kim", 250)["text"] == "TARGET: 250 N, HOLD"
        assert client.command("tension", "kim")["accepted"]
        state = until(lambda: (s := client.state()) and s["error_n"] is not None and s, "COMPENSATING")
        assert state["mode"] == "COMPENSATING"
        assert abs(state["error_n"]) <= 0.11  # the stand-in's wobble
        assert state["error_pct"] == pytest.approx(100 * abs(state["error_n"]) / 250)
        assert client.command("tension", "kim")["text"] == "TENSION refused: already COMPENSATING"


def test_a_trip_is_worded_in_state_and_events(own: Daemon) -> None:
    with own.client() as client:
        events = client.follow(client.keys.event("error"))
        client.command("target", "kim", 222.0)  # the stand-in trips
        state = until(lambda: (s := client.state()) and s["fault"] and s, "the fault")
        assert (state["mode"], state["fault"]) == ("FAULT", "TENSION_HIGH")
        assert state["fault_text"] == "tension 412.0 N above 400.0 N"
        trip, change = until(events.take, "the trip"), until(events.take, "the change of mode")
        assert trip["text"] == "trip TENSION_HIGH: tension 412.0 N above 400.0 N"
        assert (trip["kind"], trip["severity"], trip["value"], trip["limit"]) == ("TRIP", "error", 412.0, 400.0)
        assert change["text"] == "DISARMED -> FAULT: trip"
        past = client.past_events()  # by time; a late loop stamps a tick's event with the time the tick was due
        assert [event["kind"] for event in past if event["source"] == "loop"] == ["STARTED", "TRIP", "MODE"]
        assert [event["kind"] for event in past if event["source"] == "gateway"] == ["LEASE_TAKEN"]
        assert client.past_events(after=trip["seq"], after_note=1) == [
            {**change, "wall_ns": pytest.approx(change["wall_ns"], abs=1e9)}
        ]


def test_preflight_refusal_lists_the_checks(refusing: Daemon) -> None:
    with refusing.client() as client:
        refused = client.command("arm", "kim")
    assert refused["reason"] == "preflight"
    words = [check.words for check in (Check.CELL_STALE, Check.STROKE_RANGE)]
    assert refused["checks"] == words
    hint = "a device that was switched off or a CAN interface that was unplugged needs the daemon started anew"
    assert refused["text"] == f"ARM refused: {'; '.join(words)} ({hint})"


def test_a_silent_loop_is_said_so(shared: Daemon) -> None:
    with shared.client() as client:
        answer = client.command("target", "kim", 111.0)  # the stand-in does not answer this one
        assert client.command("target", "kim", 300.0)["accepted"]
    assert answer["reason"] == "no_answer"
    assert answer["text"] == "TARGET: the control loop does not answer"


@pytest.mark.parametrize("key", ["**", "rigctl/**", "rigctl/*/cmd/**", "rigctl/paper_rig/cmd/*", "lease_take", "hold"])
@pytest.mark.parametrize("way", ["gateway's socket", "loopback TCP"])
def test_zenoh_takes_no_command_without_certificates(shared: Daemon, key: str, way: str) -> None:
    """Of the same user on the same computer. A wildcard key would give every command at once."""
    with shared.client() as client, contextlib.closing(shared.remote_rig()) as reader:
        session = client.session if way == "gateway's socket" else reader.connection.session
        given = shared.runtime.commands.reader().head
        name = key if "*" in key else client.keys.command(key)
        replies = session.get(name, payload=b'{"operator": "eve"}', timeout=patience_s(), target=zenoh.QueryTarget.ALL)
        assert list(replies) == []
        assert (client.state()["lease"] or {"holder": None})["holder"] != "eve"
        assert shared.runtime.commands.reader().head == given


def test_every_arm_comes_right_after_what_the_host_says(own: Daemon) -> None:
    with own.client() as client:
        assert client.command("arm", "kim")["accepted"]
        given = own.runtime.commands.reader(from_start=True).read()
        arm = given["verb"].tolist().index(Verb.ARM)
        assert (given["verb"][arm - 1], given["host_checks"][arm - 1]) == (Setting.HOST_CHECKS, 0.0)
        preflight = own.state(client)["preflight"]
        assert preflight["failing"] == {}
        assert set(preflight["waived"]) == {"CALIBRATION", "TARE"}


def test_a_command_that_is_meant_for_another_daemon_is_not_carried_out(own: Daemon) -> None:
    commands = own.runtime.commands.reader(from_start=True)
    with own.client() as client:
        active = client.active()
        assert active["run_id"] == RUN_ID
        given = commands.read()
        refused = client.command("arm", "kim", run_id="another")
        assert (refused["accepted"], refused["reason"]) == (False, "other_run")
        assert RUN_ID in refused["text"]
        client._run_id = "another"
        assert client.take_lease("kim")["reason"] == "other_run"
        assert client.state()["lease"] is None
        assert Verb.ARM not in {int(code) for code in commands.read()["verb"]}, given
    with pytest.raises(NoDaemonError, match=f"found run {RUN_ID}, expected run another; it was not commanded"):
        Client(own.endpoint, own.settings.rig, "another")
    with Client(own.endpoint, own.settings.rig, RUN_ID) as mine:
        assert mine.command("arm", "kim")["accepted"]


def peak_mib(pid: int) -> int:
    """Most memory a process has had so far."""
    lines = pathlib.Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) // 1024 for line in lines if line.startswith("VmHWM:"))


def test_a_message_of_100_mb_is_dropped_before_it_is_put_together(own: Daemon) -> None:
    assert own.gateway is not None
    with own.client() as client:
        before = peak_mib(own.gateway.pid)
        replies = client.session.get(client.keys.state, payload=bytes(100_000_000), timeout=5.0)
        assert all(reply.ok is None for reply in replies)
        with own.client() as other:  # the link of the first still carries what it sent
            assert other.command("arm", "kim")["accepted"]
        assert peak_mib(own.gateway.pid) - before < 50
