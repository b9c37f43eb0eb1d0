"""How a client reaches a daemon: by the Unix socket in its run-time folder, else by the endpoint given.

On the daemon's computer the folder is the root of trust: of a folder that this user believes, only the daemon's
gateway can have made the socket, and the kernel decides who opens it. Whoever takes the gateway's port, also while it
is started anew, gets nothing from such a client.

Over TLS certificates say who is who. By ``tcp`` nothing is verified: a client of that reads, and commands nothing.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
from collections.abc import Callable, Sequence

from rigctl.client.local_daemons import LocalDaemon, local_daemons, meant, same_endpoint
from rigctl.config import layout
from rigctl.ipc.folder_places import COMMAND_SOCKET, GATEWAY_SOCKET, FolderPlaces
from rigctl.ipc.trusted_folders import opened

SOCKET = "unixsock-stream/"
_DESCRIPTORS = pathlib.Path("/proc/self/fd")
_FOLLOW_S = 0.2  # another run of the daemon has another folder


def _chosen(daemons: Sequence[LocalDaemon], endpoint: str, rig: str | None) -> LocalDaemon | None:
    """The daemon at an endpoint, of this name if it can be: itself, or one that joins the router there."""
    found = meant(daemons, endpoint, rig) or meant(daemons, endpoint, None)
    # Of several at one endpoint, all but one are left over from a daemon that was killed.
    return next((one for one in found if one.runs), found[0] if found else None)


class Route:
    """The way of one client to one endpoint."""

    def __init__(self, endpoint: str, rig: str | None = None, *, certified: bool = False) -> None:
        """``rig``: name if one is chosen; ``certified``: the client has a key for an endpoint ``tls/``."""
        self.given = self.endpoint = endpoint
        """The endpoint as it was given, and that which the session is opened at."""
        self.rig = ""
        """Rig whose own socket it is; empty without one."""
        self.is_alone = False
        """Whether this computer has no other rig that is reached there, so that it needs no name."""
        self._certified, self._closed_to_us = certified, ""
        self._folder: pathlib.Path | None = None
        self._fd = -1
        daemons = [] if certified else local_daemons()
        if (found := _chosen(daemons, endpoint, rig)) is not None:
            joined = any(same_endpoint(endpoint, one) for other in daemons for one in other.join)
            self.is_alone = not (found.join or joined)
            self._enter(found)

    def _enter(self, daemon: LocalDaemon) -> None:
        found = daemon.place
        if (fd := opened(found.directory)) is None:
            return
        place = FolderPlaces(_DESCRIPTORS / str(fd), shared=found.is_shared).place(GATEWAY_SOCKET)
        # While the gateway is started anew there is none: the client then waits for it, and takes no other way.
        if os.path.lexists(place) and not os.access(place, os.W_OK):
            os.close(fd)
            self._closed_to_us = str(found.place(GATEWAY_SOCKET))
            return
        self._fd, self._folder, self.rig, self.endpoint = fd, found.directory, daemon.rig, f"{SOCKET}{place}"

    @property
    def is_local(self) -> bool:
        """Whether it is a socket of this computer."""
        return self.endpoint.startswith(SOCKET)

    def _is_own(self, rig: str) -> bool:
        return self.is_local and self.rig in ("", rig)

    def command_socket(self, rig: str) -> pathlib.Path | None:
        """Where commands of this rig, and its state, go past Zenoh: beside the gateway's socket; None elsewhere."""
        place = pathlib.Path(self.endpoint.removeprefix(SOCKET)).with_name(COMMAND_SOCKET)
        return place if self._is_own(rig) and os.path.lexists(place) else None

    def words(self, rig: str) -> str:
        """Why nothing of this rig is verified and commands are not taken, in one line; empty if all is well."""
        if self._certified or self._is_own(rig):
            return ""
        if self._closed_to_us:
            why = f"this user may not open {self._closed_to_us}"
        elif self.is_local:
            why = f"{self.rig} relays it"
        else:
            why = f"this user finds no daemon of it here (expected in {layout.RUN} or {layout.SHARED_MEMORY})"
        return f"{rig} at {self.given} is not verified, and takes no command from here: {why}"

    def follow(self, end: threading.Event) -> None:
        """Have the session find the folder of the daemon's next run, until ``end``. Only for a route with a folder."""
        while not end.wait(_FOLLOW_S):
            self._follow()

    def _follow(self) -> None:
        assert self._folder is not None
        with contextlib.suppress(OSError):
            if os.path.samestat(self._folder.lstat(), os.fstat(self._fd)):
                return
            if (new := opened(self._folder)) is not None:
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
