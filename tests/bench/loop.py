"""A rig and a daemon at one rate, tensioned, kept alive between the slices of a measurement."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from typing import Any

from rigctl.bench import loop
from rigctl.config import rig_file as config
from rigctl.demo.test_rig import rehearse
from tests import daemons


class BenchRig:
    """The paper's rig, as `rigctl bench` runs it."""

    def __init__(self, rate_hz: int, stack: contextlib.ExitStack) -> None:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = loop.rehearsed(config.load(daemons.PAPER), rate_hz)
        rehearsal = stack.enter_context(rehearse(settings, folder, quiet=True))
        loop.tension(rehearsal)
        self.rig, self.endpoint = settings.rig, settings.telemetry.listen

    def measure(self, seconds: float) -> Any:
        """Records of the next ``seconds``."""
        return loop.records_of(self.rig, seconds)
