"""Our Kalman filter against the library's, to the last bit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as Library
from scipy.linalg import expm, solve_discrete_are

from rigctl.control.law.kalman import KalmanFilter, exponential, settled_covariance


@pytest.mark.parametrize("seed", range(5))
def test_every_step_gives_what_the_library_gives(seed: int) -> None:
    random = np.random.default_rng(seed)
    states, measured = 3 + seed % 2, 2
    h, noise = random.standard_normal((measured, states)), np.diag(random.uniform(0.01, 1.0, measured))
    ours, theirs = KalmanFilter(h, noise), Library(dim_x=states, dim_z=measured)
    theirs.H, theirs.R = h, noise
    ours.f = theirs.F = np.eye(states) + 0.1 * random.standard_normal((states, states))
    ours.q = theirs.Q = np.diag(random.uniform(0.0, 0.1, states))
    for _ in range(300):
        z = random.standard_normal((measured, 1))
        for each in (ours, theirs):
            each.predict()
            each.update(z)
        pairs = (ours.x, theirs.x), (ours.p, theirs.P), (ours.p_prior, theirs.P_prior), (ours.k, theirs.K)
        assert all(np.array_equal(a, b) for a, b in (*pairs, (ours.s, theirs.S)))


def test_no_process_of_the_daemon_loads_the_statistics_that_the_library_needs() -> None:
    unwanted = "{'filterpy', 'scipy.stats', 'scipy'}"
    look = f"import sys, rigctl.control.control_process; print(sorted({unwanted} & {{*sys.modules}}))"
    answer = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert answer.stdout == "[]\n"


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
