"""Figures of a run over windows, from the plant's truth, and from the loop's records beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.scenario.play import Played
from rigctl.metrics.tension_error import error_pct
from rigctl.model.states import Flag, Mode

Floats = npt.NDArray[np.float64]
Values = dict[str, float | None]

FALL = 0.05
"""A maximum is the first peak once the curve has fallen below it by this share of its whole rise: above the ripple of
friction on the way up, below the fall in the paper's moves (11 % at 0.25 deg/s, 82 % at 2 deg/s)."""


@dataclass(frozen=True)
class WindowRows:
    """One window's rows of the truth or of the loop's records."""

    rows: npt.NDArray[Any]
    t_s: Floats
    target_n: float

    def eta_pct(self, vertical_n: Floats) -> Floats:
        """Compensating error ``|Fz - Fd| / Fd`` of every row, equation (16)."""
        error: Floats = np.abs(error_pct(vertical_n, self.target_n))
        return error


@dataclass(frozen=True)
class Figure:
    """One figure: its name, which ends in its unit, its description, and its calculation from a window."""

    name: str
    meaning: str
    of: Callable[[WindowRows], float]


def _error(how: Callable[[Floats], float]) -> Callable[[WindowRows], float]:
    return lambda span: how(span.eta_pct(span.rows["vertical_n"]))


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values * values)))


def _of(field: str, how: Callable[[Floats], float]) -> Callable[[WindowRows], float]:
    return lambda span: how(span.rows[field])


def _largest(values: Floats) -> int:
    return int(np.argmax(np.abs(values)))


def _peak_deg(field: str) -> Callable[[WindowRows], float]:
    return lambda span: math.degrees(span.rows[field][_largest(span.rows[field])])


def _peak_at(field: str) -> Callable[[WindowRows], float]:
    return lambda span: float(span.t_s[_largest(span.rows[field])])


def _mean_deg(field: str) -> Callable[[WindowRows], float]:
    return lambda span: math.degrees(float(np.mean(span.rows[field])))


def _travel(values: Floats) -> float:
    return float(np.max(values) - np.min(values))


def _max_abs(values: Floats) -> float:
    return float(np.max(np.abs(values)))


def first_peak(values: Floats) -> int | None:
    """Index of the first maximum from which a curve falls by ``FALL`` of its whole rise; None if it never does.

    For the vertical force in a move it is the transition, the end of the paper's initial following stage.
    """
    highest = np.maximum.accumulate(values)
    rise = float(highest[-1] - values[0])
    fallen = np.flatnonzero(highest - values > FALL * rise)
    return int(np.argmax(values[: fallen[0] + 1])) if rise > 0.0 and len(fallen) else None


def _first_peak_n(span: WindowRows) -> float:
    at = first_peak(span.rows["vertical_n"])
    return math.nan if at is None else float(span.rows["vertical_n"][at])


def _first_peak_s(span: WindowRows) -> float:
    at = first_peak(span.rows["vertical_n"])
    return math.nan if at is None else float(span.t_s[at])


TRUTH_FIGURES = (
    Figure("eta_max_pct", "error of the vertical force, max", _error(np.max)),
    Figure("eta_rms_pct", "error of the vertical force, rms", _error(_rms)),
    Figure("eta_mean_pct", "error of the vertical force, mean", _error(np.mean)),
    Figure("vertical_max_n", "vertical force, max", _of("vertical_n", np.max)),
    Figure("vertical_max_at_s", "... at", lambda span: float(span.t_s[np.argmax(span.rows["vertical_n"])])),
    Figure("vertical_min_n", "vertical force, min", _of("vertical_n", np.min)),
    Figure("vertical_mean_n", "vertical force, mean", _of("vertical_n", np.mean)),
    Figure("vertical_first_peak_n", "vertical force, first peak", _first_peak_n),
    Figure("vertical_first_peak_at_s", "... at (transition)", _first_peak_s),
    Figure("tension_max_n", "rope tension, max", _of("tension_n", np.max)),
    Figure("tension_min_n", "rope tension, min", _of("tension_n", np.min)),
    Figure("tension_mean_n", "rope tension, mean", _of("tension_n", np.mean)),
    Figure("tangential_peak_deg", "tangential inclination, peak", _peak_deg("tangential_rad")),
    Figure("tangential_peak_at_s", "... at", _peak_at("tangential_rad")),
    Figure("tangential_mean_deg", "tangential inclination, mean", _mean_deg("tangential_rad")),
    Figure("normal_peak_deg", "normal inclination, peak", _peak_deg("normal_rad")),
    Figure("normal_peak_at_s", "... at", _peak_at("normal_rad")),
    Figure("normal_mean_deg", "normal inclination, mean", _mean_deg("normal_rad")),
    Figure("pulley_travel_mm", "pulley travel, max - min", _of("pulley_mm", _travel)),
    Figure("pulley_max_mm", "pulley from its start, max", _of("pulley_mm", _max_abs)),
    Figure("stroke_used_mm", "stroke used, max - min", _of("stroke_mm", _travel)),
    Figure("speed_max_mm_s", "cylinder speed, max", _of("speed_mm_s", _max_abs)),
    Figure("height_max_mm", "height of the payload, max", _of("height_mm", np.max)),
    Figure("height_min_mm", "height of the payload, min", _of("height_mm", np.min)),
)
"""From the plant's truth. A peak is the value of largest magnitude, with its sign."""

_LIMITED = int(Flag.LIMITED_SPEED | Flag.LIMITED_ACCELERATION | Flag.LIMITED_STROKE)


def _estimated(how: Callable[[Floats], float]) -> Callable[[WindowRows], float]:
    def figure(span: WindowRows) -> float:
        rows = span.rows
        vertical_n = rows["estimate_n"] * np.cos(rows["tangential_rad"]) * np.cos(rows["normal_rad"])
        return how(span.eta_pct(vertical_n))

    return figure


def _share(condition: Callable[[npt.NDArray[Any]], npt.NDArray[np.bool_]]) -> Callable[[WindowRows], float]:
    return lambda span: 100.0 * float(np.mean(condition(span.rows)))


def _growth(field: str) -> Callable[[WindowRows], float]:
    return lambda span: float(int(span.rows[field][-1]) - int(span.rows[field][0]))


LOOP_FIGURES = (
    Figure("estimated_eta_max_pct", "error of the estimated force, max", _estimated(np.max)),
    Figure("estimated_eta_rms_pct", "error of the estimated force, rms", _estimated(_rms)),
    Figure("estimated_eta_mean_pct", "error of the estimated force, mean", _estimated(np.mean)),
    Figure("cell_eta_max_pct", "error the cell saw, max", _error(np.max)),
    Figure("cell_eta_rms_pct", "error the cell saw, rms", _error(_rms)),
    Figure("cell_eta_mean_pct", "error the cell saw, mean", _error(np.mean)),
    Figure("command_max_mm_s", "speed commanded, max", _of("command_mm_s", _max_abs)),
    Figure("disturbance_max_mm_s", "disturbance estimated, max", _of("disturbance_mm_s", _max_abs)),
    Figure("compensating_pct", "ticks COMPENSATING", _share(lambda rows: rows["mode"] == Mode.COMPENSATING)),
    Figure("limited_pct", "ticks at a limit of the law", _share(lambda rows: (rows["flags"] & _LIMITED) != 0)),
    Figure("skipped", "ticks skipped", _growth("skipped")),
    Figure("frames_lost", "CAN frames lost", _growth("frames_lost")),
)
"""From the loop's records: its estimate, which may differ from the truth."""


def figures(played: Played, windows: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, Values] | None]:
    """``truth`` and ``loop``: for every window, every figure by name; None for a figure that does not exist.

    Args:
        played: the run.
        windows: spans in seconds by name, both ends included.
    """
    truth = {name: _over(TRUTH_FIGURES, played.truth, played.t_s, played.target_n, w) for name, w in windows.items()}
    if played.records is None or played.records_t_s is None:
        return {"truth": truth, "loop": None}
    records, t_s = played.records, played.records_t_s
    return {
        "truth": truth,
        "loop": {name: _over(LOOP_FIGURES, records, t_s, played.target_n, w) for name, w in windows.items()},
    }


_HALF_TICK_S = 1e-7  # times of rows are sums of nanoseconds, those of windows are decimal


def _over(
    table: tuple[Figure, ...], rows: npt.NDArray[Any], t_s: Floats, target_n: float, window: tuple[float, float]
) -> Values:
    inside = (t_s >= window[0] - _HALF_TICK_S) & (t_s <= window[1] + _HALF_TICK_S)
    span = WindowRows(rows[inside], t_s[inside], target_n)
    if not len(span.rows):
        return dict.fromkeys((figure.name for figure in table), None)
    found = {figure.name: float(figure.of(span)) for figure in table}
    return {name: value if math.isfinite(value) else None for name, value in found.items()}
