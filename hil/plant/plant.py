"""The plant as the simulated rig uses it: commands in, truth out, on an absolute grid of time."""

from __future__ import annotations

import math
import pathlib
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil.plant import kernel
from hil.plant.inputs import Track, pack
from hil.plant.layout import PARAMETERS, RUN_OUT, STATE, VIEW
from hil.plant.parameters import parameters
from hil.truth import Truth
from rigctl.config.settings import RigSettings


def compile_kernel() -> None:
    """Call every entry of the kernel once with no steps, which compiles it where numba has no cached code."""
    values, state, view = np.zeros(1, PARAMETERS), np.zeros(1, STATE), np.zeros(1, VIEW)
    for name in ("elements", "rope_length", "payload_mass"):
        values[name] = 1.0
    nodes, pulls, inputs = np.zeros((1, 4)), np.zeros((1, 2)), pack({})
    kernel.run(values, state, nodes, pulls, inputs, 0.0, 1e-4, 0, 0.0, True)
    kernel.observe(values, state, nodes, pulls, inputs, view, 0.0, 0.0, True)
    kernel.screw_error(values[0], 0.0)


def is_compiled() -> bool:
    """Whether numba has cached code of the kernel as it is now, so that no process compiles it for half a minute."""
    source = pathlib.Path(kernel.__file__)
    cached = pathlib.Path(kernel.run.stats.cache_path).glob(f"{source.stem}.run-*.nbi")  # type: ignore[attr-defined]
    return any(index.stat().st_mtime >= source.stat().st_mtime for index in cached)


class Swing(NamedTuple):
    """Horizontal accelerations of the rope's ends in the rail's frame, mm/s2, over the last step."""

    upper_tangential: float
    upper_normal: float
    lower_tangential: float
    lower_normal: float


class Plant:
    """Rail, pulley, rope, mechanism and cylinder, integrated in fixed steps.

    The state moves on the grid only, so the result depends on when inputs change and not on the steps of ``advance``;
    ``truth`` at a time between grid points is extrapolated from the last one.

    Args:
        settings: needs the ``simulation`` section.
        start_ns: time of the first grid point; the rope hangs plumb and slack at stroke 0, the brake is closed.

    Raises:
        ValueError: no ``simulation`` section, or a step too long for the plant.
    """

    def __init__(self, settings: RigSettings, start_ns: int) -> None:
        simulation = settings.simulation
        if simulation is None:
            raise ValueError("simulation: found nothing, expected a section (it says what rig to simulate)")
        self.t_ns = start_ns
        self._grid_ns = start_ns
        self._step_ns = simulation.step_us * 1000
        self._h = self._step_ns * 1e-9
        self.parameters = parameters(settings, simulation)
        """One record of ``layout.PARAMETERS``; a change counts from the next step on."""
        self.state = np.zeros(1, STATE)
        """One record of ``layout.STATE``, at the last grid point."""
        elements = simulation.rope.elements
        self.nodes = np.zeros((max(1, elements - 1), 4))
        """Inner nodes of a flexible rope from top to bottom: x, y (mm, in the room's frame) and their rates."""
        self._pulls = np.zeros((elements, 2))
        self._view = np.zeros(1, VIEW)
        self._delay_ns = round(settings.plant.command_delay_s * simulation.delay_scale * 1e9)
        self._on_the_way: deque[tuple[int, float]] = deque()
        self._command = 0.0
        self._braked = True
        self._inputs = pack({})
        self._origin_ns = start_ns
        self._end_ns = start_ns
        self._truth: Truth | None = None
        self._hang(simulation.pulley.rest_share)
        self._run(0)  # numba compiles or loads the kernel here, before real time begins

    @property
    def at_stroke_end(self) -> bool:
        """Whether the cylinder rests against a mechanical stop."""
        p, x = self.parameters[0], self.state[0]
        return not p["stroke_low"] < x["motor"] < p["stroke_high"]

    @property
    def moving(self) -> bool:
        """Whether a motion begun by ``start_motion`` is under way."""
        return self.t_ns < self._end_ns

    @property
    def truth(self) -> Truth:
        """The true state at ``t_ns``."""
        if self._truth is None:
            self._truth = self._look()
        return self._truth

    @property
    def swing(self) -> Swing:
        """Accelerations of the rope's ends, which an accelerometer on the rope measures too."""
        assert self.truth is not None
        return Swing(*self._view[0].tolist()[_SWING])

    def set_drive(self, velocity_mm_s: float, braked: bool, yielding_mm_s: float = 0.0) -> None:
        """The drive's output from ``t_ns`` on: commanded speed (positive = shorter rope), whether the brake holds.

        ``yielding_mm_s``: speed that the load and the motor's torque add, without delay or lag, while it does not.
        """
        if yielding_mm_s != self.state["yielding"][0]:
            self.state["yielding"] = yielding_mm_s
            self._truth = None
        latest = self._on_the_way[-1][1] if self._on_the_way else self._command
        if velocity_mm_s != latest:
            self._on_the_way.append((self.t_ns + self._delay_ns, velocity_mm_s))
        if braked != self._braked:
            self._braked = braked
            self._truth = None

    def start_motion(self, tracks: Mapping[int, Track], t_ns: int) -> None:
        """Prescribe tracks from ``t_ns`` on, by channel of ``hil.plant.layout``; replaces the previous ones."""
        self._inputs = pack(tracks)
        self._origin_ns = t_ns
        ends = [track.end for channel, track in tracks.items() if channel != RUN_OUT]
        self._end_ns = t_ns + round(max(ends, default=0.0) * 1e9)
        self._truth = None

    def preload(self, tension_n: float) -> None:
        """Set the stroke at which the plant in its present state has this tension at rest; nothing else moves."""
        p, x = self.parameters[0], self.state[0]
        if p["vertical_free"]:
            x["uz"] = (tension_n - 0.5 * p["rope_mass"] * kernel.GRAVITY) / p["vertical_stiffness"]
        self._look()
        x["play"] = 0.0
        x["motor"] += tension_n / p["stiffness"] - self._view[0]["stretch"]
        for _ in range(_SCREW_TURNS):  # the screw's own error depends on the stroke; it is small
            x["stroke"] = x["motor"] + kernel.screw_error(p, x["motor"])
            self._look()
            x["motor"] += tension_n / p["stiffness"] - self._view[0]["stretch"]
        x["motor_before"] = x["motor"]
        x["tension"] = tension_n
        self._truth = None

    def advance(self, t_ns: int) -> None:
        """Integrate up to ``t_ns``; an earlier time changes nothing."""
        if t_ns <= self.t_ns:
            return
        step_ns, waiting = self._step_ns, self._on_the_way
        left = (t_ns - self._grid_ns) // step_ns
        while left:
            middle_ns = self._grid_ns + step_ns // 2  # a command counts from the step whose middle it precedes
            while waiting and waiting[0][0] <= middle_ns:
                self._command = waiting.popleft()[1]
            count = min(left, -((middle_ns - waiting[0][0]) // step_ns)) if waiting else left
            self._run(count)
            left -= count
        self.t_ns = t_ns
        self._truth = None

    def _run(self, count: int) -> None:
        since_s = (self._grid_ns - self._origin_ns) * 1e-9
        kernel.run(
            self.parameters,
            self.state,
            self.nodes,
            self._pulls,
            self._inputs,
            since_s,
            self._h,
            count,
            self._command,
            self._braked,
        )
        self._grid_ns += count * self._step_ns

    def _hang(self, rest_share: float) -> None:
        """Pulley and the rope's nodes above the payload, the pulley out along the rail where friction holds it."""
        p, x = self.parameters[0], self.state[0]
        offset_mm = rest_share * p["pulley_static"] * p["rope_length"]  # the rope stands at atan of the coefficient
        dx, dy = p["radius"] - p["eccentricity_x"], -p["eccentricity_y"]
        x["phi"], x["r"] = math.atan2(dy, dx), math.hypot(dx, dy) + offset_mm
        elements = len(self._pulls)
        down = np.arange(1, elements) / elements
        upper_x = p["eccentricity_x"] + x["r"] * math.cos(x["phi"])
        upper_y = p["eccentricity_y"] + x["r"] * math.sin(x["phi"])
        self.nodes[: elements - 1, 0] = upper_x + down * (p["radius"] - upper_x)
        self.nodes[: elements - 1, 1] = upper_y * (1.0 - down)
        self._rail_start = float(x["phi"])
        self._pulley_start = float(x["r"])

    def _look(self) -> Truth:
        ahead_s = (self.t_ns - self._grid_ns) * 1e-9
        since_s = (self._grid_ns - self._origin_ns) * 1e-9
        kernel.observe(
            self.parameters,
            self.state,
            self.nodes,
            self._pulls,
            self._inputs,
            self._view,
            since_s,
            ahead_s,
            self._braked,
        )
        tension, vertical, tangential, normal, stroke, speed, mechanism, rail, pulley, height = self._view[0].tolist()[
            :10
        ]
        return Truth(
            self.t_ns,
            tension,
            vertical,
            tangential,
            normal,
            stroke,
            speed,
            mechanism,
            rail - self._rail_start,
            pulley - self._pulley_start,
            height,
            self.moving,
        )


_SCREW_TURNS = 4
_SWING = slice(10, 14)
