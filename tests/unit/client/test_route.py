"""Which way a client takes to a daemon: the socket of a folder that its user believes, and no other folder's."""

from __future__ import annotations

import os
import pathlib
import shutil
import socket

import pytest

from rigctl.client import route as routes
from rigctl.client.route import Route
from rigctl.config import layout
from rigctl.ipc.folder_places import PUBLIC
from rigctl.ipc.runtime_folder import Runtime
from tests.builders.waiting import until

ENDPOINT, OTHER, STRANGER = "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448", 65534


@pytest.fixture
def base(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.setattr(layout, "SHARED_MEMORY", tmp_path)
    return tmp_path


def made(base: pathlib.Path, rig: str, listen: str = ENDPOINT, *join: str, sockets: bool = True) -> pathlib.Path:
    """A daemon's folder with a socket on which nobody listens."""
    folder = base / f"rigctl-{rig}"
    folder.mkdir(mode=0o700)
    Runtime(folder).write_json(PUBLIC, {"rig": rig, "listen": listen, "join": join})
    if sockets:
        for name in ("gateway.sock", "command.sock"):
            with socket.socket(socket.AF_UNIX) as one:
                one.bind(str(folder / name))
    return folder


def leads_to(route: Route) -> pathlib.Path:
    """The folder that the socket's path leads to now."""
    return pathlib.Path(route.endpoint.removeprefix("unixsock-stream/")).parent.resolve()


def test_the_socket_of_the_rig_that_listens_there_is_taken(base: pathlib.Path) -> None:
    folder, _ = made(base, "one"), made(base, "two", OTHER)
    for rig in (None, "one"):
        route = Route("tcp/localhost:7447", rig)
        assert (route.is_local, route.rig, leads_to(route)) == (True, "one", folder)
        assert route.words("one") == ""
        place = route.command_socket("one")
        assert place is not None
        assert place.resolve() == folder / "command.sock"
        assert route.command_socket("two") is None  # what the rig there relays is not commanded
        route.leave()


def test_of_the_installed_service_the_socket_is_in_the_gateways_folder(
    base: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "RUN", base / "run")
    folder = base / "run" / "rigctl-one"
    (folder / "gateway").mkdir(parents=True)
    Runtime(folder).write_json(PUBLIC, {"rig": "one", "listen": ENDPOINT})
    route = Route(ENDPOINT)
    assert (route.rig, leads_to(route)) == ("one", folder / "gateway")
    route.leave()


def test_elsewhere_it_is_the_endpoint_and_commands_are_not_taken(base: pathlib.Path) -> None:
    made(base, "one")
    for endpoint in (OTHER, "tcp/192.0.2.1:7447"):
        route = Route(endpoint, "one")
        assert (route.endpoint, route.rig) == (endpoint, "")
        assert "is not verified, and takes no command from here" in route.words("one")
        assert "\n" not in route.words("one")
    certified = Route(ENDPOINT.replace("tcp", "tls"), "one", certified=True)
    assert (certified.endpoint, certified.words("one")) == ("tls/127.0.0.1:7447", "")
    assert certified.command_socket("one") is None
    assert Route(OTHER, "one").command_socket("one") is None


def test_a_rig_that_joins_the_router_there_has_its_own_socket(base: pathlib.Path) -> None:
    made(base, "one")
    two = made(base, "two", OTHER, ENDPOINT)
    route = Route(ENDPOINT, "two")
    assert (leads_to(route), route.words("two")) == (two, "")
    relayed = Route(ENDPOINT, "three")  # read through the first one's router
    assert (relayed.rig, relayed.command_socket("three")) == ("one", None)
    assert relayed.words("three").endswith("one relays it")
    for one in (route, relayed):
        one.leave()


def test_while_the_gateway_is_started_anew_no_other_way_is_taken(base: pathlib.Path) -> None:
    made(base, "one", sockets=False)
    route = Route(ENDPOINT)
    assert route.is_local
    route.leave()


def test_a_socket_that_this_user_may_not_open_leaves_the_endpoint(
    base: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = made(base, "one")
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and may(path, mode))
    route = Route(ENDPOINT)
    assert (route.endpoint, route.command_socket("one")) == (ENDPOINT, None)
    assert route.words("one").endswith(f"this user may not open {folder}/gateway.sock")


def test_of_several_the_one_that_runs_is_taken(base: pathlib.Path) -> None:
    for name in ("left_over", "runs", "too"):
        made(base, name)
    (base / "rigctl-runs" / "lock").write_text(f"{os.getpid()}\n")
    route = Route(ENDPOINT)
    assert route.rig == "runs"
    route.leave()


def test_a_daemon_of_the_version_before_is_read_and_has_no_socket_for_commands(base: pathlib.Path) -> None:
    (made(base, "one") / "command.sock").unlink()
    route = Route(ENDPOINT)
    assert (route.is_local, route.command_socket("one"), route.words("one")) == (True, None, "")
    route.leave()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to make another user's folder")
def test_the_next_runs_folder_is_followed_and_another_users_is_not(base: pathlib.Path) -> None:
    """In shared memory anyone may make the folder once the daemon has removed its own."""
    folder = made(base, "one")
    route = Route(ENDPOINT)
    before = leads_to(route).stat().st_ino
    shutil.rmtree(folder)
    his = made(base, "one")
    (his / "his").touch()
    os.chown(his, STRANGER, STRANGER)
    descriptor = pathlib.Path(route.endpoint.removeprefix("unixsock-stream/")).parent
    route._follow()
    assert descriptor.stat().st_ino == before
    assert not (descriptor / "his").exists()
    shutil.rmtree(his)
    (base / "elsewhere").mkdir()
    folder.symlink_to(base / "elsewhere")
    route._follow()
    assert descriptor.stat().st_ino == before
    folder.unlink()
    made(base, "one")
    route._follow()
    assert descriptor.stat().st_ino == folder.stat().st_ino
    route.leave()
    assert not os.path.lexists(descriptor)


def test_a_client_follows_in_a_thread_that_ends_with_it(base: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routes, "_FOLLOW_S", 0.001)
    folder = made(base, "one")
    route = Route(ENDPOINT)
    end = route.followed()
    shutil.rmtree(folder)
    made(base, "one")
    descriptor = pathlib.Path(route.endpoint.removeprefix("unixsock-stream/")).parent
    until(lambda: descriptor.stat().st_ino == folder.stat().st_ino, "the next folder")
    end()
    assert not os.path.lexists(descriptor)
