"""``python -m rigctl.client.counter``: an independent subscriber that counts the fast stream.

Prints ``{"ready": true}`` with the first block. After SIGTERM or SIGINT, or once it has received ``--records``, it
counts on to the record that is the newest then, and prints its figures in one JSON line.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from typing import Any

import msgspec

from rigctl.client.connection import ChoiceError, Client, NoDaemonError
from rigctl.ipc.termination import ENDING, Termination

_PERIOD_S = 0.02
_LAST_S = 5.0  # after the request to end: for records on their way, or for a gateway that is being restarted


def _print(message: dict[str, Any]) -> None:
    sys.stdout.write(msgspec.json.encode(message).decode() + "\n")
    sys.stdout.flush()


def _newest(client: Client) -> int | None:
    """Number of the newest record, 0 without any; None without an answer."""
    try:
        return int(client.state().get("seq", 0))
    except NoDaemonError:
        return None


def count(client: Client, stop: Termination, records: int | None) -> dict[str, Any]:
    """Count until ``stop`` or until ``records`` were received, then up to the record that is newest at that time."""
    blocks = client.blocks()
    ready = False
    ends: float | None = None
    newest: int | None = None
    while ends is None or (time.monotonic() < ends and (newest is None or blocks.count.last_seq < newest)):
        for _ in blocks.arrived():
            if not ready:
                ready = True
                _print({"ready": True, "first_seq": blocks.count.first_seq})
        if ends is None and (stop.requested or (records is not None and blocks.count.received >= records)):
            ends = time.monotonic() + _LAST_S
        if ends is not None and newest is None:
            newest = _newest(client)
        blocks.wait(_PERIOD_S)
    for _ in blocks.rest():
        pass
    return dataclasses.asdict(blocks.count)


def main() -> int:
    """Count; returns exit code 0, 1 without a daemon, 2 on wrong usage."""
    parser = argparse.ArgumentParser(prog="python -m rigctl.client.counter", description=__doc__)
    parser.add_argument("--connect", help="endpoint of the daemon")
    parser.add_argument("--rig", help="name of the rig")
    parser.add_argument("--records", type=int, help="end after so many")
    options = parser.parse_args()
    stop = Termination(*ENDING)
    try:
        with Client(options.connect, options.rig) as client:
            figures = count(client, stop, options.records)
    except (NoDaemonError, ChoiceError) as error:
        sys.stderr.write(f"{error}\n")
        return 1 if isinstance(error, NoDaemonError) else 2
    _print(figures)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
