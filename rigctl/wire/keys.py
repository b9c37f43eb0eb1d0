"""Zenoh keys of a rig: ``rigctl/<rig>/...``, defined once so that gateway, client and access control agree."""

from __future__ import annotations

from typing import NamedTuple

ROOT = "rigctl"
ANY_DAEMON = f"{ROOT}/*/live/daemon"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
SEVERITIES = ("info", "warning", "error")


class Keys(NamedTuple):
    """Keys of one rig.

    ``person``: name in a certificate, whose keys the commands have; empty on the rig's own socket and without
    certificates; ``*`` for anyone.
    """

    rig: str
    person: str = ""

    def _key(self, tail: str) -> str:
        return f"{ROOT}/{self.rig}/{tail}"

    @property
    def state(self) -> str:
        """Newest record and the values derived from it, JSON; published, and answered to a query."""
        return self._key("tele/state")

    @property
    def fast(self) -> str:
        """Every record in packed blocks; a query with ``after=SEQ`` gets the records after that one again."""
        return self._key("tele/fast")

    def event(self, severity: str) -> str:
        """Events of one severity, JSON; ``*`` for all."""
        return self._key(f"event/{severity}")

    @property
    def events_past(self) -> str:
        """Events still held, a JSON list: the loop's after ``after=SEQ``, the gateway's after ``after_note=SEQ``."""
        return self._key("events/past")

    @property
    def schema(self) -> str:
        """Meaning of the fast stream and of the enumerations, JSON."""
        return self._key("meta/schema")

    @property
    def active(self) -> str:
        """The active configuration: settings, design, versions, devices, real-time report, JSON."""
        return self._key("cfg/active")

    @property
    def daemon(self) -> str:
        """Liveliness token."""
        return self._key("live/daemon")

    def command(self, verb: str) -> str:
        """Command of one verb, or act on the lease; the gateway declares the key with ``*``."""
        return self._key(f"cmd/{self.person}/{verb}" if self.person else f"cmd/{verb}")

    def giver(self, key: str) -> str:
        """The person whose command a key is; empty for a command without one.

        Raises:
            ValueError: it is not the key of one command, of at most one person and one rig.
        """
        _, _, tail = key.partition(self._key("cmd/"))
        *person, verb = tail.split("/")
        if len(person) > bool(self.person) or key != Keys(self.rig, *person).command(verb) or "*" in tail:
            raise ValueError(key)
        return person[0] if person else ""


def rig_of(key: str) -> str:
    """Rig a key belongs to."""
    return key.split("/")[1]
