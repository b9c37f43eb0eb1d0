"""Where the linear plant of a rig has maxima of |S|: a measurement has to look there. No figure of it is in the result.

The plant is that of the rig as built with 0.8, 1 and 1.2 times its stiffness. A maximum that moves with the stiffness
is looked for over the whole of the way. Of a law whose linear response is not known here the mechanism's resonances
are what there is to go by: a maximum that is narrow has its cause there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.studies.compare.identification import true_plant
from hil.studies.compare.peak_search import LOW_HZ, Span
from rigctl.config.changed_settings import changed
from rigctl.config.plant_section import STIFFNESS_SCALES
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import Controller, controller
from rigctl.design.gains import OPEN, QUIET, filter_gains
from rigctl.design.margins import responses
from rigctl.design.plant_family import Member

POINTS = 4000
NARROW = 0.5
"""Least width of a maximum that the first pass finds without being led there."""
HIGH_ENOUGH = 1.0
"""Least |S| of a maximum that is looked for."""
ABOUT, WIDTH = 0.05, 0.06
"""About a resonance of the mechanism: relative frequencies, and the width of a maximum there."""


def plants(rig: RigSettings) -> list[Member]:
    """The linear plant as built, softer, as it is, and stiffer."""
    simulation = rig.simulation
    assert simulation is not None
    scales = [scale * simulation.stiffness_scale for scale in STIFFNESS_SCALES]
    return [true_plant(changed(rig, {"simulation.stiffness_scale": scale})) for scale in scales]


def of_mechanism(members: Sequence[Member]) -> list[Span]:
    """About the mechanism's resonances, without and with the rope."""
    each = zip(*(member.resonances_hz for member in members), strict=True)
    return [Span(min(hz) * (1.0 - ABOUT), max(hz) * (1.0 + ABOUT), WIDTH) for hz in each]


def law_at(believed: RigSettings, gains: Gains, level: float) -> Controller:
    """Our law with the filter's gain at a level."""
    model = filter_model(believed)
    of_setting = filter_gains(model)
    opened = of_setting[OPEN]
    quiet = of_setting.get(QUIET, opened)
    return controller(model, gains, quiet + level * (opened - quiet))


def of_loop(members: Sequence[Member], law: Controller, period_s: float, top_hz: float) -> list[Span]:
    """About the maxima of |S| of the linear loop, at either place, over all of the plants."""
    hz = np.geomspace(LOW_HZ, top_hz, POINTS)
    found = []
    for answer in responses(list(members), law, hz, period_s):
        for response in (answer.s_input, answer.s_output):
            moduli = np.abs(response)
            inner = moduli[1:-1]
            tops = np.flatnonzero((inner > moduli[:-2]) & (inner >= moduli[2:]) & (inner > HIGH_ENOUGH)) + 1
            widths = 1.0 / np.maximum(moduli * np.abs(np.gradient(1.0 / response, np.log(hz))), 1e-3)
            found += [Span(float(hz[at]), float(hz[at]), float(widths[at])) for at in tops]
    return _joined(found)


def _joined(spans: Sequence[Span]) -> list[Span]:
    """Each wider by its width on either side; those that then meet are one, with the least of their widths."""
    joined: list[Span] = []
    for span in sorted(span for span in spans if span.width < NARROW):
        low, high = span.low_hz / (1.0 + span.width), span.high_hz * (1.0 + span.width)
        if joined and low <= joined[-1].high_hz:
            last = joined[-1]
            joined[-1] = Span(min(last.low_hz, low), max(high, last.high_hz), min(last.width, span.width))
        else:
            joined.append(Span(low, high, span.width))
    return joined
