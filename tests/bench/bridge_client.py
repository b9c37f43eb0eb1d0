"""``python -m tests.bench.bridge_client PORT``: one client of the Foxglove bridge that counts records and gaps.

Prints ``{"ready": true}`` with the first record, restarts its figures on SIGUSR1, and prints them on SIGTERM.
"""

from __future__ import annotations

import json
import signal
import struct
import sys
import threading

from tests.builders.foxglove_client import FoxgloveClient

SEQ = struct.Struct("<13xxQ")
"""Of a message of data: head, the tag of field 1 of fixed width, and the record's number."""


def _say(message: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def main() -> int:
    stop, again = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGUSR1, lambda *_: again.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    received = lost = last = 0
    with FoxgloveClient(int(sys.argv[1])) as client:
        client.subscribe("/records", 1)
        while not stop.is_set():
            (seq,) = SEQ.unpack_from(client.raw())
            if not last:
                _say({"ready": True})
            else:
                lost += seq - last - 1
            last, received = seq, received + 1
            if again.is_set():
                again.clear()
                received = lost = 0
    _say({"received": received, "lost": lost})
    return 0


if __name__ == "__main__":
    sys.exit(main())
