"""The ``telemetry`` section of a rig file: where the daemon listens, and who may reach it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from rigctl.config import address
from rigctl.config.settings_base import Settings, Waiver, require

# Without # and ?, behind which Zenoh takes settings that would overrule those of the daemon.
_LISTEN = r"^(tcp|tls|unixsock-stream)/[^\s#?]+$"
_JOIN = r"^tcp/[^\s#?]+$"  # by a Unix socket it would have an operator's rights
_LOCAL = "a loopback address, tls/ with telemetry.tls, or telemetry.listen_waiver: why not, in words"


class TlsSettings(Settings):
    """Certificates of daemon and clients, from `rigctl keys`."""

    keys: str = Field(default="keys", min_length=1, description="key folder, relative to the rig file")


class TelemetrySettings(Settings):
    """Zenoh, in the gateway process."""

    listen: str = Field(default="tcp/127.0.0.1:7447", pattern=_LISTEN, description="endpoint")
    tls: TlsSettings | None = Field(default=None, description="certificates, for listen: tls/HOST:PORT")
    listen_waiver: Waiver = Field(
        default=None, description="why other computers may reach it without certificates, in words"
    )
    join: list[Annotated[str, Field(pattern=_JOIN)]] = Field(
        default_factory=list, max_length=8, description="other routers to be one network with: rigs side by side"
    )
    rate_hz: int = Field(default=50, ge=1, le=100, description="state messages and fast blocks per second")
    history_s: int = Field(default=16, ge=16, le=120, description="records the ring holds")
    lease_s: int = Field(default=300, ge=15, le=28_800, description="after a command others are kept out so long")

    @model_validator(mode="after")
    def _reached_by_whom_it_says(self) -> TelemetrySettings:
        protocol, _, where = self.listen.partition("/")
        if protocol in address.NETWORK_PROTOCOLS:
            require(address.is_address(where), "listen", self.listen, f"{protocol}/HOST:PORT")
        else:
            require(address.is_socket_path(where), "listen", self.listen, address.PATH_ALLOWED)
        if self.tls is None:
            require(protocol != "tls", "listen", self.listen, "tcp/HOST:PORT, or a section telemetry.tls too")
        else:
            require(protocol == "tls", "listen", self.listen, "tls/HOST:PORT, as there is a section telemetry.tls")
            # What another router relays has that router's certificate, not the person's.
            require(not self.join, "join", self.join, "none with telemetry.tls: a client connects to each rig")
            require(self.listen_waiver is None, "listen_waiver", self.listen_waiver, "none with telemetry.tls")
        if self.listen_waiver is None:
            for key, endpoint in (("listen", self.listen), *((f"join.{i}", one) for i, one in enumerate(self.join))):
                require(self.tls is not None or address.is_local(endpoint), key, endpoint, _LOCAL)
        return self

    @property
    def listen_here(self) -> str:
        """Endpoint for clients on this computer: no certificate is good for the address of every interface."""
        return address.here(self.listen)


def open_listen(settings: TelemetrySettings) -> str:
    """The waived setting that lets other computers in without certificates, in words; empty without one."""
    reached = [one for one in (settings.listen, *settings.join) if not address.is_local(one)]
    if settings.tls is not None or not reached:
        return ""
    return f"telemetry: other computers reach {', '.join(reached)}, to read and to give HOLD, without certificates"
