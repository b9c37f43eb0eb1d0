"""The ``page`` section of a rig file: the live page that `rigctl run` keeps running beside the daemon."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.address import ALLOWED, DEFAULT, Address, is_address
from rigctl.config.settings_base import Settings, require


class PageSettings(Settings):
    """Live page, read-only; `rigctl page --operator` is a page of its own."""

    listen: str = Field(default=str(DEFAULT), description="HOST:PORT the page is served at")

    tls_cert: str | None = Field(
        default=None, min_length=1, description="certificate chain of HTTPS, PEM, relative to the rig file"
    )
    tls_key: str | None = Field(default=None, min_length=1, description="its key, PEM, mode 0600")
    sign_in: bool = Field(
        default=False, description="reading needs a sign-in on loopback too; beyond loopback it always does"
    )

    @model_validator(mode="after")
    def _certificate_has_its_key(self) -> PageSettings:
        key = "tls_key" if self.tls_key is None else "tls_cert"
        require((self.tls_cert is None) == (self.tls_key is None), key, None, "both tls_cert and tls_key, or neither")
        return self

    @model_validator(mode="after")
    def _listen_is_an_address(self) -> PageSettings:
        require(is_address(self.listen), "listen", self.listen, ALLOWED)
        return self

    @property
    def address(self) -> Address:
        """``listen`` as an address."""
        return Address.parse(self.listen)
