"""The `audit` section of a rig file."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.address import is_address
from rigctl.config.settings_base import Settings, require


class AuditSettings(Settings):
    """Files of the recorder: the audit log, and a dump of each trip. Relative to the rig file."""

    file: str | None = Field(default=None, min_length=1, description="audit log; null = audit/RIG.jsonl")
    trips: str = Field(default="trips", min_length=1, description="folder of the trip dumps")
    trips_kept: int = Field(default=100, ge=1, le=10_000, description="trip dumps of this rig kept, the newest")
    syslog: str | None = Field(
        default=None, description="tcp/HOST:PORT or udp/HOST:PORT of a syslog collector that gets each head of the log"
    )

    @model_validator(mode="after")
    def _syslog_is_an_endpoint(self) -> AuditSettings:
        if self.syslog is not None:
            protocol, _, where = self.syslog.partition("/")
            good = protocol in ("tcp", "udp") and is_address(where)
            require(good, "syslog", self.syslog, "tcp/HOST:PORT or udp/HOST:PORT")
        return self
