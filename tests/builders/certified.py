"""A daemon in miniature that listens with certificates, and keys of people of each role."""

from __future__ import annotations

import datetime
import pathlib
from collections.abc import Iterator

from rigctl.client.connection import Client
from rigctl.config.telemetry_section import TelemetrySettings, TlsSettings
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import PEOPLE
from tests.builders.miniature import Daemon, free_port
from tests.builders.waiting import until

NAMES = dict(zip(("vera", "kim", "max"), PEOPLE, strict=True))


class CertifiedDaemon(Daemon):
    """`Daemon` whose endpoint is ``tls/``; its key folder is in its run-time folder."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        """``host``: address at which it listens."""
        super().__init__()
        folder = self.runtime.directory / "keys"
        self.keys = KeyIssuer(folder, datetime.datetime.now(datetime.UTC))
        self.keys.init([host])
        for name, role in NAMES.items():
            self.keys.add(name, role)
        self.endpoint = f"tls/{host}:{free_port()}"
        telemetry = TelemetrySettings(listen=self.endpoint, tls=TlsSettings(keys=str(folder)))
        self.settings = self.settings.model_copy(update={"telemetry": telemetry})
        written = self.runtime.read_json("active.json")
        self.runtime.write_json("active.json", {**written, "settings": self.settings.model_dump(mode="json")})

    def key(self, name: str) -> pathlib.Path:
        return self.keys.folder.issued(name)

    def client_of(self, name: str) -> Client:
        """A client with the key of ``name``, once the gateway is there."""
        found: list[Client] = []

        def opened() -> bool:
            try:
                found.append(Client(self.endpoint, self.settings.rig, key=self.key(name)))
            except RuntimeError:
                return False
            return True

        until(opened, f"the gateway at {self.endpoint}")
        return found[0]

    def renewed_gateway(self) -> None:
        """Wait until the gateway has ended by itself, and start it as the supervisor does."""
        assert self.gateway is not None
        gateway = self.gateway
        until(lambda: gateway.poll() is not None, "the gateway to end")
        assert gateway.returncode == 0
        self.start_gateway()


def certified(host: str = "127.0.0.1") -> Iterator[CertifiedDaemon]:
    found = CertifiedDaemon(host)
    try:
        found.start_loop()
        found.start_gateway()
        yield found
    finally:
        found.close()
