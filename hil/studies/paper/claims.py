"""The paper's statements, figure by figure, and their measurement in our runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil.studies.paper.cases import FIGURE_9, NO_SPRING, SPEEDS_DEG_S, speed, stiffness
from hil.studies.paper.run_truth import Floats, RunTruth
from hil.studies.planned_run import STIFFNESSES_N_MM

TARGET_N = 300.0
"""The paper's F_d."""
Runs = Mapping[str, RunTruth]
BROAD = 1e3
"""Upper bound of a trend whose size is not stated."""


class Claim(NamedTuple):
    """One row: the paper's value (None where it gives a trend only) and the range that counts as agreement."""

    id: str
    figure: str
    quantity: str
    unit: str
    paper: float | None
    low: float
    high: float
    measure: Callable[[Runs], float]
    note: str = ""
    shortfall: str = ""
    """Why the model cannot agree, where known: such a row is reported as differing, with this reason."""


class ClaimResult(NamedTuple):
    """A claim and the model's value."""

    claim: Claim
    model: float

    @property
    def ok(self) -> bool:
        """Whether the model's value lies in the claim's range; a quantity that does not exist does not."""
        return self.claim.low <= self.model <= self.claim.high

    @property
    def explained(self) -> bool:
        """Whether the row agrees, or differs for a known reason."""
        return self.ok or bool(self.claim.shortfall)


def judge(runs: Runs) -> list[ClaimResult]:
    """Every claim against the passive runs."""
    return [ClaimResult(claim, float(claim.measure(runs))) for claim in CLAIMS]


ETA_PCT = {6.0: 0.31, 13.0: 0.64, 20.0: 0.88, 27.0: 1.20, 34.0: 1.77}
PEAK_LAG_DEG = {6.0: 0.69, 13.0: 0.73, 20.0: 0.69, 27.0: 0.78, 34.0: 0.82}
PLATEAU_LAG_DEG = {6.0: 0.65, 13.0: 0.58, 20.0: 0.55, 27.0: 0.57, 34.0: 0.68}
_CONTRADICTION = {
    27.0: "the paper's own 1.20 % needs 0.69 deg (eta = k dL / Fd), it prints 0.78",
    34.0: "the paper's own 1.77 % needs 0.75 deg (eta = k dL / Fd), it prints 0.82",
}


_NORMAL = (
    "cause in the model: simulation.pulley.rest_share, the pulley rests near the edge of its friction (0.069 deg); "
    "the lag's geometry alone gives 0.012 deg. The paper's swings about 0, ours by 0.004 deg about this edge"
)


def _peak_eta(case: str) -> Callable[[Runs], float]:
    return lambda runs: float(np.max(np.abs(runs[case].eta_pct(TARGET_N))))


def _peak_lag(case: str) -> Callable[[Runs], float]:
    return lambda runs: float(np.max(runs[case].tangential_deg))


def _plateau_lag(case: str) -> Callable[[Runs], float]:
    return lambda runs: float(np.mean(runs[case].plateau(runs[case].tangential_deg)))


def _travel(case: str) -> Callable[[Runs], float]:
    return lambda runs: float(np.ptp(runs[case].pulley_mm))


def _normal(case: str) -> Callable[[Runs], float]:
    return lambda runs: float(np.max(np.abs(runs[case].normal_deg)))


def _figure_4() -> list[Claim]:
    bare, soft = NO_SPRING, stiffness(6.0)
    return [
        Claim(
            "fig4_k1000_peak_fz", "4", "k 1000: peak Fz", "N", 455.0, 443.0, 467.0,
            lambda runs: float(np.max(runs[bare].vertical_n)),
            "at the paper's 0.80 deg it would be 475 N; 455 N is 0.752 deg",
        ),
        Claim(
            "fig4_k1000_plateau_fz", "4", "k 1000: plateau Fz, mean", "N", 435.0, 420.0, 450.0,
            lambda runs: float(np.mean(runs[bare].plateau(runs[bare].vertical_n))),
            "the headline 45 % is this plateau; the paper's own peak is 51.7 %",
        ),
        Claim("fig4_k1000_peak_lag", "4", "k 1000: peak lag", "deg", 0.80, 0.66, 0.82, _peak_lag(bare)),
        Claim(
            "fig4_k1000_plateau_lag", "4", "k 1000: plateau lag, mean", "deg", 0.65, 0.45, 0.70, _plateau_lag(bare),
            "printed 0.60-0.70; only its upper end gives the printed 435 N",
        ),
        Claim(
            "fig4_k1000_transition", "4", "k 1000: transition", "s", 4.5, 3.5, 5.0,
            lambda runs: runs[bare].first_peak_s(),
        ),
        Claim("fig4_k6_peak_lag", "4", "k 6: peak lag", "deg", 0.70, 0.66, 0.82, _peak_lag(soft)),
        Claim(
            "fig4_k6_peak_fz", "4", "k 6: peak Fz", "N", 301.0, 300.74, 301.12,
            lambda runs: float(np.max(runs[soft].vertical_n)), "the range is 0.31 % +- 20 %",
        ),
        Claim(
            "fig4_k6_peak_time", "4", "k 6: transition", "s", 4.0, 3.5, 5.0,
            lambda runs: runs[soft].first_peak_s(), "section 2.1; section 2.2 has the greatest lag at about 7 s",
        ),
        Claim(
            "fig4_k6_plateau_lag", "4", "k 6: plateau lag, mean", "deg", 0.525, 0.45, 0.70, _plateau_lag(soft),
            "0.45-0.60 in section 2.1, 0.65 in section 2.2",
        ),
        Claim(
            "fig4_travel_ratio", "4", "pulley travel, k 1000 over k 6", "", 1.0, 0.95, 1.05,
            lambda runs: _travel(bare)(runs) / _travel(soft)(runs), "printed: no effect of the spring",
        ),
        Claim("fig4_k1000_travel", "4", "k 1000: pulley travel", "mm", 0.25, 0.15, 0.35, _travel(bare)),
        Claim(
            "fig4_k1000_normal", "4", "k 1000: normal inclination, largest", "deg", 0.07, 0.05, 0.09, _normal(bare),
            _NORMAL,
        ),
    ]  # fmt: skip


def _figure_5_6() -> list[Claim]:
    claims = []
    for k in STIFFNESSES_N_MM:
        case = stiffness(k)
        share = 0.25 if k == 27.0 else 0.20
        eta = ETA_PCT[k]
        claims += [
            Claim(
                f"fig6_k{k:g}_peak_eta", "5/6", f"k {k:g}: peak eta", "%", eta, round(eta * (1.0 - share), 6),
                round(eta * (1.0 + share), 6), _peak_eta(case),
            ),
            Claim(
                f"fig5_k{k:g}_peak_lag", "5/6", f"k {k:g}: peak lag", "deg", PEAK_LAG_DEG[k], 0.66, 0.82,
                _peak_lag(case), _CONTRADICTION.get(k, ""),
            ),
            Claim(
                f"fig5_k{k:g}_plateau_lag", "5/6", f"k {k:g}: plateau lag, mean", "deg", PLATEAU_LAG_DEG[k], 0.45,
                0.70, _plateau_lag(case),
            ),
            Claim(f"fig5_k{k:g}_travel", "5/6", f"k {k:g}: pulley travel", "mm", 0.25, 0.15, 0.35, _travel(case)),
            Claim(
                f"fig5_k{k:g}_normal", "5/6", f"k {k:g}: normal inclination, largest", "deg", 0.07, 0.05, 0.09,
                _normal(case), _NORMAL,
            ),
        ]  # fmt: skip
    soft, stiff = stiffness(STIFFNESSES_N_MM[0]), stiffness(STIFFNESSES_N_MM[-1])
    claims += [
        Claim(
            "fig5_travel_spread", "5/6", "pulley travel, largest over smallest", "", 1.0, 1.0, 1.05,
            lambda runs: _spread(_travel(stiffness(k))(runs) for k in STIFFNESSES_N_MM), "printed: independent of k",
        ),
        Claim(
            "fig6_overshoot_grows", "5/6", "peak eta per step of k, smallest ratio", "", None, 1.0, BROAD,
            lambda runs: _least_growth(_peak_eta(stiffness(k))(runs) for k in STIFFNESSES_N_MM),
            "printed: the lower k, the smaller the overshoot",
        ),
        Claim(
            "fig5_response_slower", "5/6", "transition, k 6 less k 34", "s", None, 0.0, BROAD,
            lambda runs: runs[soft].first_peak_s() - runs[stiff].first_peak_s(),
            "section 2.2: the lower k, the longer; section 2.1: k 6 quicker (4.0 s) than no spring (4.5 s)",
            "the rail breaks away once the mechanism is 22 mm ahead, then swings on the rope with a period set by mass "
            "and tension: nothing in it knows the spring but the 1 % of tension",
        ),
        Claim(
            "fig6_stretch", "5/6", "k dL / Fd: dL from the five errors, mean", "mm", 0.145, 0.133, 0.157,
            _stretch_mm, "one law fits all five printed errors within 0.012 mm",
        ),
    ]  # fmt: skip
    return claims


def _figure_7() -> list[Claim]:
    def each(measure: Callable[[str], Callable[[Runs], float]], runs: Runs) -> list[float]:
        return [measure(speed(w))(runs) for w in SPEEDS_DEG_S]

    def swing(values: str) -> Callable[[str], Callable[[Runs], float]]:
        return lambda case: lambda runs: float(np.ptp(runs[case].plateau(getattr(runs[case], values))))

    def rise(case: str) -> Callable[[Runs], float]:
        return lambda runs: -runs[case].first_peak_s()

    def mean(case: str) -> Callable[[Runs], float]:
        return lambda runs: float(np.mean(runs[case].plateau(runs[case].vertical_n)))

    trend = "printed as a trend, without the speeds"

    def grows(id_: str, what: str, measure: Callable[[str], Callable[[Runs], float]]) -> Claim:
        quantity = f"{what} per step of speed, smallest ratio"
        return Claim(id_, "7", quantity, "", None, 1.0, BROAD, lambda runs: _least_growth(each(measure, runs)), trend)

    return [
        grows("fig7_overshoot", "peak eta", _peak_eta),
        Claim(
            "fig7_rise_time", "7", "transition per step of speed, least shortening", "s", None, 0.0, BROAD,
            lambda runs: _least_step(each(rise, runs)), trend,
        ),
        Claim(
            "fig7_mean", "7", "mean plateau Fz, largest over smallest", "", 1.0, 1.0, 1.005,
            lambda runs: _spread(each(mean, runs)), "printed: relatively constant; half a percent is 1.5 N",
        ),
        grows("fig7_fluctuation", "plateau Fz peak to peak", swing("vertical_n")),
        grows("fig7_normal", "normal inclination peak to peak", swing("normal_deg")),
        grows("fig7_travel", "pulley travel", _travel),
    ]  # fmt: skip


def _figure_9() -> list[Claim]:
    soft = stiffness(6.0)

    return [
        Claim(
            "fig9_accuracy", "9", "unloading accuracy", "%", 97.0, 96.0, 98.0,
            lambda runs: 100.0 - _peak_eta(FIGURE_9)(runs),
            "with the declared 1.5 mm of level error: 9 N of 300; at least 95 is required",
        ),
        Claim(
            "fig9_following", "9", "following: largest lag", "deg", 1.0, 0.0, 1.0,
            lambda runs: float(np.max(np.abs(runs[FIGURE_9].tangential_deg))), "printed: better than 1 deg",
        ),
        Claim(
            "fig9_fluctuation", "9", "fluctuation of Fz, measured over simulated", "", None, 1.0, BROAD,
            lambda runs: _fluctuation(runs[FIGURE_9]) / _fluctuation(runs[soft]), "printed: exceeds the simulation's",
        ),
        Claim(
            "fig9_angle_lower", "9", "largest lag on the way out, simulated less measured", "deg", None, 0.0, BROAD,
            lambda runs: _peak_lag(soft)(runs) - float(np.max(_way_out(runs[FIGURE_9]))),
            "printed: lower than simulated, where rail and motion incline alike",
        ),
    ]  # fmt: skip


def _way_out(run: RunTruth) -> Floats:
    out: Floats = run.tangential_deg[run.t_s < 0.5 * run.t_s[-1]]
    return out


def _fluctuation(run: RunTruth) -> float:
    """Standard deviation of Fz within a second of the plateau, its trend taken out; the median second."""
    values = run.plateau(run.vertical_n)
    seconds = values[: len(values) // 1000 * 1000].reshape(-1, 1000)
    t = np.arange(1000.0) - 499.5
    slopes = seconds @ t / (t @ t)
    return float(np.median(np.std(seconds - np.outer(slopes, t), axis=1)))


def _stretch_mm(runs: Runs) -> float:
    """Mean over k of eta Fd / k, equation (16) solved for the stretch."""
    return float(np.mean([_peak_eta(stiffness(k))(runs) / 100.0 * TARGET_N / k for k in STIFFNESSES_N_MM]))


def _spread(values: Iterable[float]) -> float:
    listed = list(values)
    return max(listed) / min(listed) if min(listed) > 0.0 else math.inf


def _least_growth(values: Iterable[float]) -> float:
    listed = list(values)
    return min(b / a if a else math.inf for a, b in pairwise(listed))


def _least_step(values: Iterable[float]) -> float:
    listed = list(values)
    return min(b - a for a, b in pairwise(listed))


CLAIMS = [*_figure_4(), *_figure_5_6(), *_figure_7(), *_figure_9()]
