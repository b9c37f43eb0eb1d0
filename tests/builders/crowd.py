"""A local user without rights (uid 65534) whose connections do nothing: to take a daemon's places.

``python crowd.py KIND NUMBER ENDPOINT`` opens so many, prints ``ready``, and keeps them until its standard input ends.
"""

from __future__ import annotations

import contextlib
import pathlib
import resource
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(pathlib.Path(__file__).parents[2]))

from rigctl.wire.session import SessionError, open_client
from tests.builders.intruder import become_nobody


@contextlib.contextmanager
def crowd(kind: str, number: int, endpoint: str) -> Iterator[None]:
    """The process, from the test's side. ``kind``: of `KINDS`."""
    command = [sys.executable, __file__, kind, str(number), endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/") as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield
        finally:
            process.kill()


def _session(endpoint: str) -> Any:
    with contextlib.suppress(SessionError):  # of one that is closed while it opens
        return open_client(endpoint)


def _half_open(endpoint: str) -> Any:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with contextlib.suppress(OSError):  # the queue of the listening socket is full
        one = socket.socket()
        one.settimeout(1.0)
        one.connect((host, int(port)))
        return one


KINDS = {"sessions": _session, "half_open": _half_open}


def main(kind: str, number: str, endpoint: str) -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    become_nobody()
    kept = [KINDS[kind](endpoint) for _ in range(int(number))]
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.read()
    del kept


if __name__ == "__main__":
    main(*sys.argv[1:])
