"""Asking the daemon what a stream needs to go on; one that is away for a moment is asked again."""

from __future__ import annotations

import time

import zenoh

from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.source import Question, Source

AGAIN_S = 0.1
PATIENCE_S = 20.0  # then the ring has been written over, as rings are by default


class Enquiry:
    """What one stream asks."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._away_since: float | None = None
        self._again_at = 0.0

    def settle(self, source: Source[object], question: Question) -> bool:
        """Ask, and tell ``source`` what was answered; False: nobody answered, try again ``AGAIN_S`` later.

        Tried sooner it does nothing. A refusal is an answer; so is the silence of ``PATIENCE_S``.
        """
        now = time.monotonic()
        if now < self._again_at:
            return False
        try:
            answered, payload = self._client.ask(question.selector, check=question.check)
        except (NoDaemonError, zenoh.ZError):
            now = time.monotonic()
            self._away_since = now if self._away_since is None else self._away_since
            if now - self._away_since < PATIENCE_S and not source.mailbox.closed:
                self._again_at = now + AGAIN_S
                return False
            answered, payload = False, b""
        self._away_since, self._again_at = None, 0.0
        source.answer(payload if answered else None)
        return True
