"""A rig and a daemon at one rate, tensioned, kept alive between the slices of a measurement."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile

from rigctl.bench import loop
from rigctl.config import rig_file as config
from rigctl.demo.live_rig import LiveRig, start_live_rig
from tests.builders import daemons


def bench_rig(rate_hz: int, stack: contextlib.ExitStack) -> LiveRig:
    """The paper's rig in the settings of `rigctl bench`."""
    folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
    settings = loop.bench_settings(config.load(daemons.PAPER), rate_hz)
    live_rig = stack.enter_context(start_live_rig(settings, folder, loop.OPERATOR, quiet=True))
    loop.tension(live_rig)
    return live_rig
