"""Our Kalman filter against the library's, to the last bit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as Library
from scipy.linalg import expm, solve_discrete_are

from rigctl.control.law.estimator import _inverse
from rigctl.control.law.kalman import KalmanFilter, exponential, settled_covariance


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


@pytest.mark.parametrize("seed", range(5))
def test_the_settled_covariance_and_the_exponential_are_those_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    f = exponential(0.1 * random.standard_normal((4, 4)) * 10.0 ** (seed - 3))
    assert f == pytest.approx(
        expm(0.1 * np.random.default_rng(seed).standard_normal((4, 4)) * 10.0 ** (seed - 3)), rel=1e-9
    )
    f /= 1.01 * np.abs(np.linalg.eigvals(f)).max()
    h, r = random.standard_normal((2, 4)), np.diag(random.uniform(0.01, 1.0, 2))
    q = np.diag(random.uniform(1e-6, 0.1, 4))
    assert settled_covariance(f, h, q, r) == pytest.approx(solve_discrete_are(f.T, h.T, q, r), rel=1e-8, abs=1e-12)
