"""Our Kalman filter against the library's, to the last bit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as Library

from rigctl.control.estimator import _inverse
from rigctl.control.kalman import KalmanFilter


@pytest.mark.parametrize("seed", range(5))
def test_every_step_gives_what_the_library_gives(seed: int) -> None:
    random = np.random.default_rng(seed)
    states, measured = 3 + seed % 2, 2
    h, noise = random.standard_normal((measured, states)), np.diag(random.uniform(0.01, 1.0, measured))
    ours, theirs = KalmanFilter(h, noise), Library(dim_x=states, dim_z=measured, dim_u=1)
    theirs.H, theirs.R = h, noise
    ours.f = theirs.F = np.eye(states) + 0.1 * random.standard_normal((states, states))
    ours.b = theirs.B = random.standard_normal((states, 1))
    ours.q = theirs.Q = np.diag(random.uniform(0.0, 0.1, states))
    for step in range(300):
        command = random.standard_normal()
        ours.predict(command if step % 3 else None)
        theirs.predict(u=command if step % 3 else None)
        z = random.standard_normal((measured, 1))
        if step % 5 == 0:
            ours.update(z[1:], slice(1, 2))
            theirs.update(z[1:], noise[1:, 1:], h[1:])
        else:
            ours.update(z)
            theirs.update(z)
        pairs = (ours.x, theirs.x), (ours.p, theirs.P), (ours.p_prior, theirs.P_prior), (ours.k, theirs.K)
        assert all(np.array_equal(a, b) for a, b in (*pairs, (ours.s, theirs.S)))


def test_no_process_of_the_daemon_loads_the_statistics_that_the_library_needs() -> None:
    unwanted = "{'filterpy', 'scipy.stats', 'scipy'}"
    look = f"import sys, rigctl.control.control_process; print(sorted({unwanted} & {{*sys.modules}}))"
    answer = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert answer.stdout == "[]\n"


@pytest.mark.parametrize("matrix", [[[4.0]], [[4.0, 1.0], [1.0, 3.0]], [[2.0, -0.5], [-0.5, 0.25]]])
def test_the_inverse_of_an_innovations_covariance_is_its_inverse(matrix: list[list[float]]) -> None:
    covariance = np.array(matrix)
    assert _inverse(covariance) @ covariance == pytest.approx(np.eye(len(matrix)), abs=1e-12)
