"""Whether the daemon's gateway is alive, from its liveliness token."""

from __future__ import annotations

import contextlib
import threading

import zenoh


class Liveliness:
    """Follows one token. The end of a gateway shows at once, a hanging gateway after Zenoh's lease (10 s)."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._changed = threading.Condition()
        self._alive = False
        self._subscriber = session.liveliness().declare_subscriber(key, self._take, history=True)

    def _take(self, sample: zenoh.Sample) -> None:
        if "*" in str(sample.key_expr):
            return
        with self._changed:
            self._alive = sample.kind == zenoh.SampleKind.PUT
            self._changed.notify_all()

    @property
    def alive(self) -> bool:
        """Whether the token exists now."""
        return self._alive

    def wait(self, alive: bool, timeout_s: float | None) -> bool:
        """Wait until the token exists (``alive``) or is gone; returns whether that happened within ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: self._alive is alive, timeout_s)

    def close(self) -> None:
        """End the subscription."""
        with contextlib.suppress(zenoh.ZError):
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
