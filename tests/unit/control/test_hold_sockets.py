"""The loop's sockets for HOLD, with users of real processes: a flood, descriptors, senders that do not read."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import pwd
import resource
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from rigctl.config import layout
from rigctl.control.bus import hold_sockets
from rigctl.control.bus.hold_sockets import REST_NS, Hold, HoldSockets
from rigctl.ipc import hold_socket
from rigctl.ipc.hold_socket import HoldAnswer, socket_name
from rigctl.ipc.runtime_folder import Runtime
from tests.builders.waiting import patience_s

TICK_NS = 1_000_000
ANSWER = HoldAnswer(7, True, 0, 0, 0, 52.3, 300.0, "HOLD")
OWN = os.geteuid()
ROOT = pytest.mark.skipif(OWN != 0, reason="needs root, to run processes of other users")
NOBODY, DAEMON = pwd.getpwnam("nobody").pw_uid, pwd.getpwnam("daemon").pw_uid
UNLISTED = (4_000_001, 4_000_002)  # users that /etc/passwd does not have
FLOOD = """
import os, socket, sys
os.setgroups([]); os.setgid(int(sys.argv[2])); os.setuid(int(sys.argv[2]))
sockets = []
for _ in range(4):
    sockets.append(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    sockets[-1].setblocking(False)
sys.stdout.write("floods\\n"); sys.stdout.flush()
while True:
    for one in sockets:
        try:
            one.sendto(b"flood", sys.argv[1])
        except OSError:
            pass
"""
GIVE = """
import os, pathlib, sys
from rigctl.ipc.hold_socket import give
os.setgroups([]); os.setgid(int(sys.argv[2])); os.setuid(int(sys.argv[2]))
try:
    print(give(pathlib.Path(sys.argv[1]), "kim", 60.0, int(sys.argv[3])))
except OSError as error:
    print(error.strerror)
"""


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Runtime]:
    """A run-time folder as the installed service has it."""
    base = layout.SHARED_MEMORY / f"rigctl-test-holds-{os.getpid()}"
    base.mkdir(mode=0o755)
    monkeypatch.setattr(layout, "RUN", base)
    found = Runtime.of("paper_rig", base)
    found.claim()
    yield found
    found.remove()
    base.rmdir()


class Ticks:
    """The sockets with a loop that takes and answers."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime, self.sockets = runtime, HoldSockets.of(runtime)
        self.t_ns, self.taken = 0, list[Hold]()

    def tick(self) -> Hold | None:
        self.t_ns += TICK_NS
        if (hold := self.sockets.take(self.t_ns)) is not None:
            self.taken.append(hold)
            self.sockets.answer(self.t_ns, ANSWER._replace(t_ns=self.t_ns))
        return hold

    def ticks(self, count: int) -> list[Hold]:
        return [hold for _ in range(count) if (hold := self.tick()) is not None]

    def place(self, uid: int | None) -> pathlib.Path:
        return self.runtime.place(socket_name(uid))

    def by(self, uid: int, place: pathlib.Path) -> tuple[str, int]:
        """Give HOLD as a user on a socket; returns what the sender prints, and the ticks that it took."""
        words = [sys.executable, "-c", GIVE, str(place), str(uid), str(OWN)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            count = 0
            while process.poll() is None:
                self.tick()
                count += 1
            assert process.stdout is not None
            return process.stdout.read().strip(), count


@pytest.fixture
def rig(runtime: Runtime) -> Iterator[Ticks]:
    found = Ticks(runtime)
    yield found
    found.sockets.close()


@contextlib.contextmanager
def flooding(place: pathlib.Path, uid: int) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", FLOOD, str(place), str(uid)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def given(place: pathlib.Path, operator: str = "kim") -> tuple[threading.Thread, list[HoldAnswer | None]]:
    found: list[HoldAnswer | None] = []
    thread = threading.Thread(target=lambda: found.append(hold_socket.give(place, operator, 60.0, OWN)), daemon=True)
    thread.start()
    return thread, found


def test_a_hold_has_the_kernels_user_and_process_and_its_sender_reads_the_answer(rig: Ticks) -> None:
    thread, found = given(rig.place(OWN), "Zoë")
    while thread.is_alive():
        rig.tick()
    assert rig.taken == [Hold(OWN, os.getpid(), "Zoë")]
    assert found == [ANSWER._replace(t_ns=found[0].t_ns if found[0] else 0)]


def test_a_tick_takes_one_and_a_users_socket_rests_after_each(rig: Ticks) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        for number in range(5):
            one.sendto(f"{number}".encode(), str(rig.place(OWN)))
    assert [hold.operator for hold in rig.ticks(1 + REST_NS // TICK_NS)] == ["0", "1"]
    assert [hold.operator for hold in rig.ticks(3 * REST_NS // TICK_NS)] == ["2", "3", "4"]


def test_what_would_write_on_a_terminal_or_in_a_log_is_no_name(rig: Ticks) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.sendto(b"kim\x1b[2J\nERROR: " + b"x" * 5000, str(rig.place(OWN)))
    (hold,) = rig.ticks(1)
    assert hold.operator == "kim?[2J?ERROR: " + "x" * (hold_socket.NAME_BYTES - 15)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.sendto("Zoë\u202e\x9b".encode(), str(rig.place(OWN)))
    rig.ticks(REST_NS // TICK_NS)
    assert [hold.operator for hold in rig.taken[1:]] == ["Zo???"]


def test_an_answer_of_another_user_than_the_folders_is_none(rig: Ticks) -> None:
    found: list[HoldAnswer | None] = []
    thread = threading.Thread(
        target=lambda: found.append(hold_socket.give(rig.place(OWN), "kim", 60.0, OWN + 1)), daemon=True
    )
    thread.start()
    while thread.is_alive():
        rig.tick()
    assert found == [None]
    assert [hold.operator for hold in rig.taken] == ["kim"]


@ROOT
def test_a_user_has_a_socket_that_no_other_can_use(rig: Ticks) -> None:
    answered, _ = rig.by(NOBODY, rig.place(NOBODY))
    assert answered.startswith("HoldAnswer(")
    assert [hold.uid for hold in rig.taken] == [NOBODY]
    assert rig.by(DAEMON, rig.place(NOBODY))[0] == "Permission denied"
    assert rig.by(DAEMON, rig.place(None))[0] == "Permission denied"  # he has his own
    assert rig.by(UNLISTED[0], rig.place(None))[0].startswith("HoldAnswer(")
    assert [hold.uid for hold in rig.taken] == [NOBODY, UNLISTED[0]]


@ROOT
def test_a_users_flood_delays_no_other_users_hold(rig: Ticks) -> None:
    with flooding(rig.place(DAEMON), DAEMON), flooding(rig.place(None), UNLISTED[0]):
        for _ in range(5):
            before = len(rig.taken)
            answered, _ = rig.by(NOBODY, rig.place(NOBODY))
            assert answered.startswith("HoldAnswer("), answered
            assert [hold.uid for hold in rig.taken[before:]].count(NOBODY) == 1
    floods = [hold for hold in rig.taken if hold.uid != NOBODY]
    assert {hold.uid for hold in floods} == {DAEMON, UNLISTED[0]}
    assert len(floods) <= 2 * (1 + rig.t_ns / REST_NS)


@ROOT
def test_in_a_flood_the_next_tick_but_two_takes_another_users_hold(rig: Ticks) -> None:
    """Ticks are counted here, since it is the loop's promise that matters, not how busy the computer is."""
    with flooding(rig.place(DAEMON), DAEMON), flooding(rig.place(None), UNLISTED[0]):
        rig.ticks(200)
        for _ in range(20):
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
                one.sendto(b"kim", str(rig.place(OWN)))
            taken = rig.ticks(3)
            assert [hold.operator for hold in taken].count("kim") == 1, taken
            rig.ticks(REST_NS // TICK_NS)


def lingering() -> tuple[socket.socket, socket.socket]:
    """A TCP socket whose last close waits an hour, or for its peer's end: it has sent what that does not read."""
    listener = socket.create_server(("127.0.0.1", 0))
    one = socket.create_connection(listener.getsockname())
    peer = listener.accept()[0]
    listener.close()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 3600))
    one.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            one.send(b"x" * 65536)
    return one, peer


@pytest.mark.parametrize("kernel_refuses", [True, False])
def test_a_descriptor_sent_along_is_never_closed_in_a_tick(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch, kernel_refuses: bool
) -> None:
    """Its close would stop the loop for an hour."""
    if not kernel_refuses:
        monkeypatch.setattr(hold_sockets, "_SO_PASSRIGHTS", 0xFFFF)  # as before Linux 6.16
    rig = Ticks(runtime)
    one = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sent, peer = lingering()
    try:
        one.connect(str(rig.place(OWN)))
        try:
            socket.send_fds(one, [b"eve"], [sent.fileno()])
        except PermissionError:
            sent.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes(8))
        sent.close()  # the one in the queue is the last
        one.send(b"kim")
        thread = threading.Thread(target=lambda: rig.ticks(100), daemon=True)
        thread.start()
        thread.join(patience_s())
        assert not thread.is_alive(), "a tick waits for the close of a descriptor"
        if any(hold.closed for hold in rig.taken):
            assert rig.taken == [Hold(OWN, os.getpid(), "eve", closed=True)]  # a HOLD, and the last of this user
        else:
            assert kernel_refuses
            assert [hold.operator for hold in rig.taken] == ["kim"]
    finally:
        peer.close()
        one.close()


def test_who_does_not_read_or_has_gone_costs_the_loop_nothing(rig: Ticks) -> None:
    for _ in range(40):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
            one.bind("")
            one.sendto(b"kim", str(rig.place(OWN)))
        assert len(rig.ticks(REST_NS // TICK_NS)) == 1


def test_no_answer_goes_to_a_path_in_the_senders_file_system(rig: Ticks, tmp_path: pathlib.Path) -> None:
    """To look it up could block: in a file system of the sender's own, or on a server that is gone."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "own"))
        one.sendto(b"kim", str(rig.place(OWN)))
        assert len(rig.ticks(2)) == 1
        one.setblocking(False)
        with pytest.raises(BlockingIOError):
            one.recv(100)


def test_a_loop_that_was_killed_leaves_its_sockets_to_the_next(runtime: Runtime) -> None:
    first = HoldSockets.of(runtime)
    second = Ticks(runtime)
    thread, found = given(second.place(OWN))
    while thread.is_alive():
        second.tick()
    assert found[0] is not None
    first.close()
    second.sockets.close()


@ROOT
def test_in_a_checkouts_folder_every_user_gives_hold() -> None:
    base = layout.SHARED_MEMORY / f"rigctl-test-holds-{os.getpid()}"
    base.mkdir(mode=0o755)
    found = Runtime.of("paper_rig", base)
    found.directory.mkdir(mode=0o700)  # left by a daemon of the version before
    found.claim()
    rig = Ticks(found)
    try:
        assert found.directory.stat().st_mode & 0o777 == 0o711
        for uid, place in ((NOBODY, rig.place(NOBODY)), (UNLISTED[0], rig.place(None))):
            assert rig.by(uid, place)[0].startswith("HoldAnswer(")
        assert [hold.uid for hold in rig.taken] == [NOBODY, UNLISTED[0]]
    finally:
        rig.sockets.close()
        found.remove()
        base.rmdir()


def test_without_access_lists_the_users_share_a_socket(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "setxattr", refuse)
    HoldSockets.of(runtime).close()
    names = {path.name for path in runtime.directory.glob("hold.*")}
    assert names == {socket_name(OWN), socket_name(None)}


def test_a_user_for_whom_there_is_no_room_shares_a_socket_and_takes_no_other_away(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound = hold_sockets._bound

    def full(runtime: Runtime, uid: int | None) -> socket.socket:
        if uid == DAEMON:
            raise OSError(errno.ENOSPC, "No space left on device")
        return bound(runtime, uid)

    monkeypatch.setattr(hold_sockets, "_users", lambda: [DAEMON, OWN])
    monkeypatch.setattr(hold_sockets, "_bound", full)
    sockets = HoldSockets.of(runtime)
    for name in (socket_name(OWN), socket_name(None)):
        hold_socket.give(runtime.place(name), "kim", 0.0, OWN)
    found = [sockets.take(n * TICK_NS) for n in range(4)]
    sockets.close()
    assert sum(hold is not None for hold in found) == 2


def test_a_directory_of_very_many_users_gives_sockets_to_persons_first_and_leaves_descriptors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A computer in a domain knows thousands; the loop's files, its bus and its rings need descriptors too."""
    everyone = [SimpleNamespace(pw_uid=uid) for uid in (*range(1, 900), *range(5000, 9000), 0)]
    monkeypatch.setattr(pwd, "getpwall", lambda: everyone)
    for descriptors, served in ((1_000_000, 250), (400, 100)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, most=descriptors: (most, most))
        assert hold_sockets._users() == [0, *range(5000, 5000 + served - 1)]
