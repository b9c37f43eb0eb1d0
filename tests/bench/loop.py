"""A rig and a daemon at one rate, tensioned, kept alive between the slices of a measurement."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from typing import Any

from rigctl.bench import loop
from rigctl.config import rig_file as config
from rigctl.demo.live_rig import start_live_rig
from tests.builders import daemons


class BenchRig:
    """The paper's rig in the settings of `rigctl bench`."""

    def __init__(self, rate_hz: int, stack: contextlib.ExitStack) -> None:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = loop.bench_settings(config.load(daemons.PAPER), rate_hz)
        live_rig = stack.enter_context(start_live_rig(settings, folder, quiet=True))
        loop.tension(live_rig)
        self.rig, self.endpoint = settings.rig, settings.telemetry.listen

    def measure(self, seconds: float) -> Any:
        """Records of the next ``seconds``."""
        return loop.records_of(self.rig, seconds)
