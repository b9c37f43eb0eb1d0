"""Queries a stream needs to continue; a daemon that is away for a moment is queried again."""

from __future__ import annotations

import time

import zenoh

from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.source import Question, Source

AGAIN_S = 0.1
PATIENCE_S = 20.0  # after it a ring of default size has been overwritten


class Enquiry:
    """Queries of one stream."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._away_since: float | None = None
        self._again_at = 0.0

    def settle(self, source: Source[object], question: Question) -> bool:
        """Query the daemon and pass the answer to ``source``; False: no answer, call again ``AGAIN_S`` later.

        A call before that does nothing. A refusal counts as an answer, and so do ``PATIENCE_S`` without one.
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
