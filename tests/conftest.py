"""What holds for every test: hypothesis judges results, not how long a busy machine took for them."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("rigctl", deadline=None)
settings.load_profile("rigctl")
