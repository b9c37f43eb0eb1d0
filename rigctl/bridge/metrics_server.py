"""The HTTP server of a page of metrics: it answers to this computer's names alone, with a bounded number of threads."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, make_wsgi_app

from rigctl.config.address import Address, names_server

CONNECTIONS = 16
REQUEST_S = 5.0  # without a byte of the request, or with an answer that is not taken
_App = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]


class MetricsServer(ThreadingMixIn, WSGIServer):
    """Serves a registry in threads of its own from the beginning on; one connection above the limit is closed."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, address: Address, registry: CollectorRegistry) -> None:
        """Listen.

        Raises:
            CannotListenError: the port is in use, may not be used, or the host is not this computer's.
        """
        listening = address.listen()
        self.address_family = listening.family
        super().__init__(listening.getsockname()[:2], _Request, bind_and_activate=False)
        self.socket.close()
        self.socket = listening
        self.address = Address(address.host, listening.getsockname()[1])
        self.server_name, self.server_port = self.address
        self.setup_environ()
        self.set_app(_guarded(make_wsgi_app(registry), self.address))
        self._places = threading.BoundedSemaphore(CONNECTIONS)
        threading.Thread(target=self.serve_forever, name="metrics", daemon=True).start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """See `socketserver.BaseServer`."""
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """See `socketserver.ThreadingMixIn`."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away or was too slow is no error of this server; any other is shown."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def close(self) -> None:
        """Stop listening."""
        self.shutdown()
        self.server_close()


class _Request(WSGIRequestHandler):
    timeout = REQUEST_S

    def handle(self) -> None:
        with contextlib.suppress(OSError):
            super().handle()

    def log_message(self, *_: Any) -> None:
        """Nothing is logged: whoever reaches the port could fill the log."""


def _guarded(app: _App, address: Address) -> _App:
    """``app`` for requests whose Host names this server; others get 421."""

    def answer(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        if names_server(environ.get("HTTP_HOST", ""), address):
            return app(environ, start)
        start("421 Misdirected Request", [("Content-Type", "text/plain")])
        return [b"this server does not go by that name\n"]

    return answer
