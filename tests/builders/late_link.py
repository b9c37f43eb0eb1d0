"""A TCP relay that sends chosen queries on late: what a busy daemon or a bad network looks like to a client."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator, Sequence


class LateLink:
    """Relays to ``endpoint``; the first query on each of ``keys`` waits ``late_s``, as does what follows it."""

    def __init__(self, listener: socket.socket, endpoint: str, keys: Sequence[str], late_s: float) -> None:
        host, port = endpoint.removeprefix("tcp/").split(":")
        self._listener, self._daemon, self._late_s = listener, (host, int(port)), late_s
        self._keys, self._lock = {key.encode() for key in keys}, threading.Lock()
        self.endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def unasked(self) -> set[str]:
        """Keys that no client has asked for yet."""
        return {key.decode() for key in self._keys}

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # the listener is closed
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._relay, args=(client,), daemon=True).start()

    def _relay(self, client: socket.socket) -> None:
        with client, socket.socket() as daemon, contextlib.suppress(OSError):
            daemon.connect(self._daemon)
            back = threading.Thread(target=_copy, args=(daemon, client), daemon=True)
            back.start()
            with contextlib.suppress(OSError):
                while data := client.recv(1 << 16):
                    if self._is_late(data):
                        time.sleep(self._late_s)
                    daemon.sendall(data)
                daemon.shutdown(socket.SHUT_WR)
            back.join()

    def _is_late(self, data: bytes) -> bool:
        with self._lock:
            first = {key for key in self._keys if key in data}
            self._keys -= first
        return bool(first)


def _copy(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            sink.sendall(data)
        sink.shutdown(socket.SHUT_WR)


@contextlib.contextmanager
def late_link(endpoint: str, keys: Sequence[str], late_s: float) -> Iterator[LateLink]:
    """A `LateLink` within the context."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield LateLink(listener, endpoint, keys, late_s)
