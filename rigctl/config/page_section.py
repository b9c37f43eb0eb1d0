"""The ``page`` section of a rig file: the live page that `rigctl run` keeps running beside the daemon."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigctl.config.page_address import ALLOWED, DEFAULT, Address, is_address
from rigctl.config.settings_base import Settings, require


class PageSettings(Settings):
    """Live page, read-only; `rigctl page --operator` is a page of its own."""

    listen: str = Field(default=str(DEFAULT), description="HOST:PORT the page is served at")

    @model_validator(mode="after")
    def _listen_is_an_address(self) -> PageSettings:
        require(is_address(self.listen), "listen", self.listen, ALLOWED)
        return self

    @property
    def address(self) -> Address:
        """``listen`` as an address."""
        return Address.parse(self.listen)
