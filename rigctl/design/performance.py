"""Performance of a design on the plant of the file: disturbance, sensitivity and noise, from the linear closed loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.kalman import stationary_covariance
from rigctl.design.closed_loop import Controller, closed_loop
from rigctl.design.plant_family import member

VERTICAL_MM, VERTICAL_HZ = 10.0, 0.1  # the payload's slow vertical motion, by which a design is judged
SHAKE_HZ = (3.0, 8.0)  # floor and building vibration


@dataclass(frozen=True)
class Performance:
    """Figures of the linear loop with the file's plant; peaks for sines, rms for noise."""

    vertical_error_n: float  # true tension, peak, for 10 mm at 0.1 Hz
    sensitivity_3hz: float  # true tension over that of a locked stroke, disturbance at 3 Hz
    sensitivity_8hz: float  # the same at 8 Hz
    command_noise_mm_s: float  # rms, from the cell's noise in the file
    command_noise_per_speed: float  # rms of the command per rms of drive-speed noise
    tension_noise_n: float  # rms of the true tension, from the cell's noise


def performance(settings: RigSettings, law: Controller) -> Performance:
    """Figures for the plant in the file, unscaled."""
    plant = member(settings, settings.plant.mechanism_n_mm, loss_scale=1.0)
    loop = closed_loop(plant, law)
    dt = 1.0 / settings.loop.rate_hz
    z = np.exp(2j * np.pi * np.array([VERTICAL_HZ, *SHAKE_HZ]) * dt)
    pencil = z[:, None, None] * np.eye(len(loop.a)) - loop.a
    held = np.broadcast_to(loop.b[:, 2:].astype(np.complex128), (len(z), len(loop.b), 1))
    disturbed = np.abs(np.linalg.solve(pencil, held)[:, :, 0] @ loop.tension + loop.loss_n_s_mm)
    speed = VERTICAL_MM * np.abs(z[0] - 1.0) / dt
    locked = np.abs(plant.response(z)[2])
    noise_n = settings.tension_cell.noise_n
    by_cell = stationary_covariance(loop.a, np.outer(loop.b[:, 0], loop.b[:, 0]) * noise_n**2)
    by_speed = stationary_covariance(loop.a, np.outer(loop.b[:, 1], loop.b[:, 1]))
    return Performance(
        vertical_error_n=float(disturbed[0] * speed),
        sensitivity_3hz=float(disturbed[1] / locked[1]),
        sensitivity_8hz=float(disturbed[2] / locked[2]),
        command_noise_mm_s=float(np.sqrt(loop.command @ by_cell @ loop.command)),
        command_noise_per_speed=float(np.sqrt(loop.command @ by_speed @ loop.command)),
        tension_noise_n=float(np.sqrt(loop.tension @ by_cell @ loop.tension)),
    )
