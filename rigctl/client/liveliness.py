"""Whether the daemon's gateway is there, from its liveliness token."""

from __future__ import annotations

import contextlib
import threading

import zenoh


class Liveliness:
    """Follows one token. A gateway that ended shows at once, one that hangs after Zenoh's lease (10 s)."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._changed = threading.Condition()
        self._alive = False
        self._subscriber = session.liveliness().declare_subscriber(key, self._take, history=True)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self._alive = sample.kind == zenoh.SampleKind.PUT
            self._changed.notify_all()

    @property
    def alive(self) -> bool:
        """Whether the token stands now."""
        return self._alive

    def wait(self, alive: bool, timeout_s: float | None) -> bool:
        """Wait until it is there, or gone; whether that came about within ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: self._alive is alive, timeout_s)

    def close(self) -> None:
        """Follow it no more."""
        with contextlib.suppress(zenoh.ZError):
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
