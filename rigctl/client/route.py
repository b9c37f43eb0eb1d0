"""How a client reaches a daemon: by the Unix socket in its run-time folder, else by the endpoint given.

On the daemon's computer the folder is the root of trust: of a folder that this user believes, only the daemon's
gateway can have made the socket, and the kernel decides who opens it. Whoever takes the gateway's port, also while it
is started anew, gets nothing from such a client.

Over TLS certificates say who is who. By ``tcp`` nothing is verified: a client of that reads, and gives HOLD.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec

from rigctl.client.local_hold import same_endpoint
from rigctl.config import layout
from rigctl.ipc.folder_files import FolderFiles
from rigctl.ipc.folder_places import COMMAND_SOCKET, GATEWAY_SOCKET
from rigctl.ipc.trusted_folders import opened, trusted_folders
from rigctl.wire.public_file import PUBLIC, PublicFile

SOCKET = "unixsock-stream/"
_DESCRIPTORS = pathlib.Path("/proc/self/fd")
_FOLLOW_S = 0.2  # another run of the daemon has another folder


class LocalDaemon(NamedTuple):
    """A daemon of this computer whose run-time folder this user believes."""

    folder: pathlib.Path
    public: PublicFile


def local_daemons() -> Iterator[LocalDaemon]:
    """The daemons of this computer that this user may believe."""
    for folder in trusted_folders():
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            yield LocalDaemon(folder, msgspec.convert(FolderFiles(folder).read_json(PUBLIC), PublicFile))


def _chosen(endpoint: str, rig: str | None) -> LocalDaemon | None:
    """The daemon at an endpoint, of this name if it can be: itself, or one that joins the router there."""
    daemons = list(local_daemons())
    here = [one for one in daemons if same_endpoint(endpoint, one.public.listen)]
    named = [one for one in here if rig in (None, one.public.rig)]
    joining = [
        one for one in daemons
        if one.public.rig == rig and any(same_endpoint(endpoint, joined) for joined in one.public.join)
    ]  # fmt: skip
    found = named or joining or here
    # Of several at one endpoint, all but one are left over from a daemon that was killed.
    alive = [one for one in found if _answers(one.folder)] if len(found) > 1 else []
    return next(iter(alive or found), None)


def _socket_in(folder: pathlib.Path, *, shared: bool) -> pathlib.Path:
    return FolderFiles(folder, shared=shared).place(GATEWAY_SOCKET)


def _answers(folder: pathlib.Path) -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as tried:
        tried.connect(str(_socket_in(folder, shared=folder.parent == layout.RUN)))
        return True
    return False


class Route:
    """The way of one client to one endpoint."""

    def __init__(self, endpoint: str, rig: str | None = None, *, certified: bool = False) -> None:
        """``rig``: name if one is chosen; ``certified``: the client has a key for an endpoint ``tls/``."""
        self.given = self.endpoint = endpoint
        """The endpoint as it was given, and that which the session is opened at."""
        self.rig = ""
        """Rig whose own socket it is; empty without one."""
        self._certified, self._closed_to_us = certified, ""
        self._folder: LocalDaemon | None = None
        self._fd = -1
        if not certified and (found := _chosen(endpoint, rig)) is not None:
            self._enter(found)

    def _enter(self, daemon: LocalDaemon) -> None:
        if (fd := opened(daemon.folder)) is None:
            return
        shared = daemon.folder.parent == layout.RUN
        place = _socket_in(_DESCRIPTORS / str(fd), shared=shared)
        # While the gateway is started anew there is none: the client then waits for it, and takes no other way.
        if os.path.lexists(place) and not os.access(place, os.W_OK):
            os.close(fd)
            self._closed_to_us = str(_socket_in(daemon.folder, shared=shared))
            return
        self._fd, self._folder, self.rig, self.endpoint = fd, daemon, daemon.public.rig, f"{SOCKET}{place}"

    @property
    def is_local(self) -> bool:
        """Whether it is a socket of this computer."""
        return self.endpoint.startswith(SOCKET)

    def commands(self, rig: str) -> bool:
        """Whether commands of this rig other than HOLD are taken this way; then its answers are verified too."""
        return self._certified or (self.is_local and self.rig in ("", rig))

    def command_socket(self, rig: str) -> pathlib.Path | None:
        """Where commands of this rig, and its state, go past Zenoh: beside the gateway's socket; None elsewhere."""
        if self._certified or not self.is_local or not self.commands(rig):
            return None
        return pathlib.Path(self.endpoint.removeprefix(SOCKET)).with_name(COMMAND_SOCKET)

    def words(self, rig: str) -> str:
        """Why nothing of this rig is verified and commands are not taken, in one line; empty if all is well."""
        if self.commands(rig):
            return ""
        if self._closed_to_us:
            why = f"this user may not open {self._closed_to_us}"
        elif self.is_local:
            why = f"{self.rig} relays it"
        else:
            why = f"this user finds no daemon of it here (expected in {layout.RUN} or {layout.SHARED_MEMORY})"
        return f"{rig} at {self.given} is not verified, and takes no command but HOLD from here: {why}"

    def follow(self, end: threading.Event) -> None:
        """Have the session find the folder of the daemon's next run, until ``end``. Only for a route with a folder."""
        while not end.wait(_FOLLOW_S):
            self._follow()

    def _follow(self) -> None:
        assert self._folder is not None
        with contextlib.suppress(OSError):
            if os.path.samestat(self._folder.folder.lstat(), os.fstat(self._fd)):
                return
            if (new := opened(self._folder.folder)) is not None:
                os.dup2(new, self._fd, inheritable=False)  # the session connects by the path of this descriptor
                os.close(new)

    def followed(self) -> Callable[[], None]:
        """Begin to `follow` in a thread; returns what ends it and closes the folder."""
        if self._folder is None:
            return lambda: None
        end = threading.Event()
        thread = threading.Thread(target=self.follow, args=(end,), name="run-time folder", daemon=True)
        thread.start()

        def close() -> None:
            end.set()
            thread.join()
            self.leave()

        return close

    def leave(self) -> None:
        """Close the folder's descriptor, after the session."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
