"""The family of plants about an identified one: what the ledger says of a rig, widened by stated amounts.

`rigctl identify` puts stiffness, lag and delay on record, its frequency response the mechanism's K_m too, each with an
uncertainty of 95 %. A plant is a value of each within

    half width = max(identified_error_factor x uncertainty, a floor)

because the uncertainty is of the measurement alone and of that day: a spring warms, a drive's lag changes with its
load and its temperature, the drive's own cycle is not in phase with the bus, and a mechanism's K_m changes with its
posture. The floors are settings of `design`. Members are the corners of stiffness, lag and delay and their middle, with
each K_m. The loss of spring and rope is a corner too; `rigctl identify` without a response does not find it, and then
the family reaches from none to twice that of the rig file. The mechanism's damping is the least found, which is the
worst. What else is found is left out, because it changes Ms over a family by less than `LEFT_OUT` says (a test).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from itertools import product
from typing import Any, NamedTuple

from rigctl.config.changed_settings import changed
from rigctl.config.plant_section import MECHANISMS_N_MM
from rigctl.config.settings import RigSettings
from rigctl.design.plant_family import LOSS_SCALE, MECHANISM_DAMPING, Family, Member, sampled
from rigctl.ipc import wall_clock
from rigctl.ipc.ledger import Entry, entry_digest, moment

IDENTIFY, RESPONSE = "identify", "response"  # actions of the ledger whose figures are of the plant
WINDOW = "margins"  # entry of the gateway where the margins measured each minute begin or cease to differ
_CORNERS = ("stiffness_n_mm", "lag_s", "delay_s", "damping_n_s_mm")
SAME_SPRING = 1e-4  # relative: stiffness of the rig file then and now; a response has it in six digits
SAME_POINT = 0.1  # of the larger tension: nearer ones are one operating point ...
SAME_STROKE_MM = 15.0  # ... if their strokes are this near
LEFT_OUT = {"payload_kg": 0.02, "gain": 0.001, "speed_age_s": 0.005, "backlash": 0.0, "noise": 0.0}
"""Most that a quantity found, and left out of the family, changes its Ms: payload by 20 %, the drive's speed over the
command by 1 %, the age of the speed it reports by 2 ms. Backlash and noise are of no linear plant."""
LEAST_RATIO = 0.002
DAMPING_HALF = 0.5  # of the mechanism's damping found: it is less on another day
LATE_PERIODS = 0.5  # a tick wakes late by 0 to nearly a period: so much about the delay that was found
DELAY_ERROR_S = 2e-3  # largest uncertainty of a delay that counts as identified
FIT_MAX = 2.0  # residuals over their standard deviation; a response beyond it is not of this model
_ROWS = {
    "stiffness": "stiffness_n_mm",
    "plant.cylinder_lag_s": "lag_s",
    "plant.command_delay_s": "delay_s",
    "plant.mechanism_n_mm": "mechanism_n_mm",
}  # keys of `identify`


class NotIdentifiedError(ValueError):
    """The ledger does not identify the plant; ``str()`` is one line that says what is missing."""


class Uncertain(NamedTuple):
    """A value and its expanded uncertainty at 95 %."""

    value: float
    error: float


@dataclass(frozen=True)
class Identified:
    """The plant of a rig at one operating point.

    ``when``: date of the oldest entry that a figure is from. ``believed_n_mm``: stiffness by the rig file of that day,
    which tells the spring that was mounted. Without ``mechanism_n_mm`` no resonance was found: K_m is above
    ``mechanism_above_n_mm``, or unknown.
    """

    when: str
    entries: tuple[str, ...]  # SHA-256 of each ledger entry used
    tension_n: float
    believed_n_mm: float
    stiffness_n_mm: Uncertain
    lag_s: Uncertain
    delay_s: Uncertain
    mechanism_n_mm: Uncertain | None = None
    mechanism_above_n_mm: float | None = None
    stroke_mm: float | None = None  # at which it was identified; None: not on record
    damping_n_s_mm: Uncertain | None = None  # of spring and rope; None: not identified
    mechanism_damping: Uncertain | None = None  # of critical; None: not identified

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Identified:
        """From JSON values; the inverse of `as_dict`."""
        figures: dict[str, Any] = {
            name: Uncertain(*value) if isinstance(value, list | tuple) and name != "entries" else value
            for name, value in values.items()
        }
        figures["entries"] = tuple(values["entries"])
        return cls(**figures)


class Range(NamedTuple):
    """Lowest and highest value of a figure over the family."""

    low: float
    high: float

    def meets(self, found: Uncertain) -> bool:
        """Whether a later finding can be of a value in this range."""
        return found.value - found.error <= self.high and found.value + found.error >= self.low


class _Finding(NamedTuple):
    """The figures of one ledger entry; those it did not determine are missing."""

    entry: Entry
    tension_n: float
    believed_n_mm: float
    figures: dict[str, Uncertain]
    above_n_mm: float | None
    stroke_mm: float | None = None
    at: int = 0  # place of the entry in the ledger, which is the order of writing whatever the clock read


def points(entries: Sequence[Entry], settings: RigSettings) -> list[Identified]:
    """The identified plant at each operating point at which it was, with the spring of the settings, by tension.

    A point is a tension and a stroke. Newer figures replace older ones at the same point; what a point does not
    determine is taken from the others.

    Raises:
        NotIdentifiedError: stiffness, lag or delay is not on record.
    """
    mounted = settings.plant.stiffness_n_mm
    every = _findings(entries, settings.tension_cell.late_s)
    found = [item for item in every if same_spring(item.believed_n_mm, mounted)]
    newest_first = found[::-1]
    at: list[list[_Finding]] = []
    for item in newest_first:
        near = next((group for group in at if _same_point(group[0], item)), None)
        if near is None:
            at.append([item])
        else:
            near.append(item)
    spring = f"with a stiffness of {mounted:.4g} N/mm in the rig file"
    if not found:
        raise NotIdentifiedError(f"no identification {spring} is on record: run `rigctl identify`")
    # A point of its own needs a stiffness of its own.
    groups = [group for group in at if any("stiffness_n_mm" in item.figures for item in group)]
    merged = [_merged([*group, *newest_first], spring) for group in groups or at[:1]]
    return sorted(merged, key=lambda point: point.tension_n)


def springs(entries: Sequence[Entry]) -> list[float]:
    """Stiffness by the rig file of each spring with which the rig was identified, in N/mm, the newest first."""
    kept: list[float] = []
    for item in reversed(list(_findings(entries))):
        if not any(same_spring(item.believed_n_mm, other) for other in kept):
            kept.append(item.believed_n_mm)
    return kept


def same_spring(a_n_mm: float, b_n_mm: float) -> bool:
    """Whether two stiffnesses by the rig file are of the same spring."""
    return math.isclose(a_n_mm, b_n_mm, rel_tol=SAME_SPRING)


def nearest(found: Sequence[Identified], tension_n: float) -> Identified:
    """The operating point nearest to a tension."""
    return min(found, key=lambda point: abs(point.tension_n - tension_n))


def outdated(found: Identified, settings: RigSettings, now: datetime) -> str | None:
    """Why an identification is too old to be believed, in one line; None if it is not."""
    days = settings.design.identify_days
    age = wall_clock.age(moment(found.when), now)
    if age is not None and age > timedelta(days=days):
        return f"the identification of {found.when[:10]} is {age.days} days old, design.identify_days is {days}"
    return None


def contradicted(found: Identified, entries: Sequence[Entry], settings: RigSettings) -> str | None:
    """The ledger entry since ``found`` that its family does not predict, in one line; None if there is none.

    That is a later stiffness, lag, delay or K_m at the same tension that no plant of the family has, a response that
    the model does not fit, a measured Ms that is above the limit of the design beyond its uncertainty, or a sensitivity
    that differs from the predicted one (`differing`).
    """
    if (why := differing(entries, found)) is not None:
        return why
    ranges = widened(found, settings)
    since = next((at for at, item in enumerate(entries) if entry_digest(item) in found.entries), 0)
    for item in _findings(entries, settings.tension_cell.late_s):
        date, figures = item.entry.when[:10], item.entry.figures
        if item.at < since or entry_digest(item.entry) in found.entries:
            continue
        if not same_spring(item.believed_n_mm, found.believed_n_mm) or not _same_point(item, found):
            continue
        for name, figure in item.figures.items():
            if (allowed := ranges.get(name)) is not None and not allowed.meets(figure):
                return (
                    f"the {item.entry.what} of {date} found {name} {figure.value:.4g} +- {figure.error:.2g}, "
                    f"the identification of {found.when[:10]} allows {allowed.low:.4g} to {allowed.high:.4g}"
                )
        if (fit := _number(figures.get("fit"))) is not None and fit > FIT_MAX:
            return f"the response of {date} does not fit the model (residuals {fit:.1f} times their noise)"
        if (peak := _measured_ms(figures)) is not None and peak.value - peak.error > settings.design.ms_max:
            limit = settings.design.ms_max
            return (
                f"the response of {date} measured Ms {peak.value:.2f} +- {peak.error:.2f}, expected at most {limit:g}"
            )
    return None


def differing(entries: Sequence[Entry], found: Identified | None) -> str | None:
    """Why the loop's sensitivity is not the predicted one, in one line, by the newest entry that compared them.

    None if it is, or if ``found`` was identified from then on: that is the answer to a difference.
    """
    whats = (RESPONSE, WINDOW)
    compared = [at for at, item in enumerate(entries) if item.what in whats and "difference" in item.figures]
    if not compared or not isinstance(worst := entries[compared[-1]].figures["difference"], dict):
        return None
    newest, *later = entries[compared[-1] :]
    if found is not None and any(entry_digest(item) in found.entries for item in (newest, *later)):
        return None
    at = {name: _number(worst.get(name)) or 0.0 for name in ("hz", "measured", "error", "low", "high")}
    return (
        f"the {newest.what} of {newest.when[:10]} measured |S| {at['measured']:.2f} +- {at['error']:.2f} at "
        f"{at['hz']:.3g} Hz, the design had {at['low']:.2f} to {at['high']:.2f}"
    )


def widened(found: Identified, settings: RigSettings) -> dict[str, Range]:
    """The range of each figure over the family; none of K_m where only a bound is known."""
    design = settings.design
    floors = {
        "stiffness_n_mm": 0.01 * design.identified_stiffness_pct * found.stiffness_n_mm.value,
        "lag_s": 0.01 * design.identified_lag_pct * found.lag_s.value,
        "delay_s": max(0.001 * design.identified_delay_ms, LATE_PERIODS / settings.loop.rate_hz),
    }
    figures = {name: getattr(found, name) for name in floors}
    if found.mechanism_n_mm is not None:
        floors["mechanism_n_mm"] = 0.01 * design.identified_mechanism_pct * found.mechanism_n_mm.value
        figures["mechanism_n_mm"] = found.mechanism_n_mm
    ranges = {
        name: _about(figures[name], max(floor, design.identified_error_factor * figures[name].error), name)
        for name, floor in floors.items()
    }
    return ranges | {"damping_n_s_mm": _damping(found, settings)}


def _damping(found: Identified, settings: RigSettings) -> Range:
    """The loss of spring and rope: as found, or as assumed where only `identify` without a response is on record."""
    design = settings.design
    if (damping := found.damping_n_s_mm) is None:
        return Range(0.0, LOSS_SCALE * settings.plant.damping_n_s_mm)
    floor = 0.01 * design.identified_damping_pct * damping.value
    half = max(floor, design.identified_error_factor * damping.error)
    return Range(max(0.0, damping.value - half), damping.value + half)


def mechanisms(found: Identified, settings: RigSettings) -> tuple[float | None, ...]:
    """Stiffnesses K_m of the family, None = rigid: the identified range, or the assumed list above the bound found."""
    if found.mechanism_n_mm is not None:
        low, high = widened(found, settings)["mechanism_n_mm"]
        return high, found.mechanism_n_mm.value, low
    bound = found.mechanism_above_n_mm
    if bound is None:
        own = settings.plant.mechanism_n_mm
        return tuple(dict.fromkeys((*MECHANISMS_N_MM, own)))
    return (*(k_m for k_m in MECHANISMS_N_MM if k_m is None or k_m > bound), bound)


def family(settings: RigSettings, found: Identified) -> Family:
    """The plants a design for the identified plant is judged over; scales are of the plant in the settings."""
    plant, ranges = settings.plant, widened(found, settings)
    c_n_s_mm = plant.damping_n_s_mm if found.damping_n_s_mm is None else found.damping_n_s_mm.value
    middle = (found.stiffness_n_mm.value, found.lag_s.value, found.delay_s.value, c_n_s_mm)
    figures = [*product(*(ranges[name] for name in _CORNERS)), middle]

    def made(k_m: float | None, k_n_mm: float, lag_s: float, delay_s: float, c_n_s_mm: float) -> Member:
        delay_scale = delay_s / plant.command_delay_s if plant.command_delay_s > 0.0 else 1.0
        ticks = delay_s * settings.loop.rate_hz
        scales = k_n_mm / plant.stiffness_n_mm, lag_s / plant.cylinder_lag_s, delay_scale
        return sampled(settings, k_m, *scales, ticks, c_n_s_mm, mechanism_damping=ratio)

    ratio = MECHANISM_DAMPING
    if (damped := found.mechanism_damping) is not None:
        half = max(DAMPING_HALF * damped.value, settings.design.identified_error_factor * damped.error)
        ratio = max(damped.value - half, LEAST_RATIO)
    members = tuple(made(k_m, *figure) for k_m in mechanisms(found, settings) for figure in figures)
    return Family(f"identified {found.when[:10]}", members)


def in_words(found: Identified, settings: RigSettings) -> str:
    """The family in one line: each figure with its half width."""
    ranges = widened(found, settings)

    def say(name: str, title: str, unit: str, factor: float = 1.0) -> str:
        low, high = (factor * end for end in ranges[name])
        return f"{title} {low:.4g} to {high:.4g} {unit}"

    words = [say("stiffness_n_mm", "k", "N/mm"), say("lag_s", "lag", "ms", 1e3), say("delay_s", "delay", "ms", 1e3)]
    if found.mechanism_n_mm is not None:
        words.append(say("mechanism_n_mm", "K_m", "N/mm"))
    else:
        k_m = [f"{value:.4g}" if value is not None else "rigid" for value in mechanisms(found, settings)]
        words.append(f"K_m {', '.join(k_m)} N/mm")
    return f"{', '.join(words)}, at {found.tension_n:.0f} N"


def model_of(settings: RigSettings, found: Identified) -> dict[str, float | None]:
    """The identified plant as values of the rig file's keys, which estimator and design believe from then on.

    The spring follows from the stiffness with the rope of the file, equation (17); without a spring it is the rope's.

    Raises:
        NotIdentifiedError: the stiffness is larger than the rope's of the rig file alone.
    """
    plant, stiffness = settings.plant, found.stiffness_n_mm.value
    values: dict[str, float | None] = {}
    if plant.spring_n_mm is None:
        values["plant.rope_n_mm"] = stiffness
    else:
        compliance = 1.0 / stiffness - 1.0 / plant.rope_n_mm
        if compliance <= 0.0:
            raise NotIdentifiedError(
                f"found a stiffness of {stiffness:.4g} N/mm, the rope of the rig file alone has {plant.rope_n_mm:g}: "
                "correct plant.rope_n_mm, and identify again"
            )
        values["plant.spring_n_mm"] = 1.0 / compliance
    if found.damping_n_s_mm is not None:
        values |= _chain(settings, stiffness, found.damping_n_s_mm.value, values)
    values["plant.cylinder_lag_s"] = found.lag_s.value
    values["plant.command_delay_s"] = found.delay_s.value
    if found.mechanism_n_mm is not None:
        values["plant.mechanism_n_mm"] = found.mechanism_n_mm.value
    elif plant.mechanism_n_mm not in mechanisms(found, settings):
        values["plant.mechanism_n_mm"] = None
    return values


def _chain(
    settings: RigSettings, stiffness: float, damping_n_s_mm: float, parts: Mapping[str, float | None]
) -> dict[str, float | None]:
    """The losses of spring and rope whose chain has the damping found: the rope's of the file, the spring's the rest.

    Exact, but where the rope of the file alone would lose more: then the spring has none and the rope the whole.
    """
    rope = parts.get("plant.rope_n_mm") or settings.plant.rope_n_mm
    spring, of_rope = parts.get("plant.spring_n_mm"), settings.plant.rope_damping_n_s_mm
    if spring is None:
        return {"plant.rope_damping_n_s_mm": damping_n_s_mm}
    left = damping_n_s_mm - of_rope * (stiffness / rope) ** 2
    if left < 0.0:
        return {
            "plant.spring_damping_n_s_mm": 0.0,
            "plant.rope_damping_n_s_mm": damping_n_s_mm * (rope / stiffness) ** 2,
        }
    return {"plant.spring_damping_n_s_mm": left * (spring / stiffness) ** 2}


def believing(settings: RigSettings, found: Identified) -> RigSettings:
    """The settings with the identified plant in place of that of the rig file."""
    return changed(settings, model_of(settings, found))


def _findings(entries: Iterable[Entry], late_s: float = 0.0) -> Iterator[_Finding]:
    """The entries with figures of the plant, in their order; ``late_s``: by the cell's low-pass, no delay of theirs."""
    for at, item in enumerate(entries):
        if item.what == IDENTIFY:
            found = _of_rows(item)
        elif item.what == RESPONSE:
            found = _of_response(item, late_s)
        else:
            continue
        if found is not None:
            yield found._replace(at=at)


def _of_rows(item: Entry) -> _Finding | None:
    """An entry of `identify`: a list of rows with key, ``found`` and ``error``."""
    listed = item.figures.get("rows")
    rows = {row.get("key"): row for row in listed if isinstance(row, dict)} if isinstance(listed, list) else {}
    figures = {
        name: _pair(rows[key].get("found"), rows[key].get("error")) for key, name in _ROWS.items() if key in rows
    }
    believed = _number(rows.get("stiffness", {}).get("before"))
    above = _number(rows.get("plant.mechanism_n_mm", {}).get("above"))
    return _finding(item, believed, figures, above)


def _of_response(item: Entry, late_s: float) -> _Finding | None:
    """An entry of `identify --response`; what the tension is late by beyond ``late_s`` counts as delay of the plant."""
    plant = item.figures.get("plant")
    if not isinstance(plant, dict):
        return None
    names = (*_ROWS.values(), "sensor_delay_s", "damping_n_s_mm", "mechanism_damping")
    read = {name: _pair(*_value_error(plant.get(name))) for name in names}
    delay, late = read["delay_s"], read.pop("sensor_delay_s")
    if delay is not None and late is not None:
        both = Uncertain(max(0.0, delay.value + late.value - late_s), math.hypot(delay.error, late.error))
        if both.error <= DELAY_ERROR_S:
            read["delay_s"] = both
        else:  # an entry of before `plant_fit` held a damping that it cannot separate
            read["delay_s"] = read["damping_n_s_mm"] = None
    mechanism = plant.get("mechanism_n_mm")
    above = _number(mechanism.get("above")) if isinstance(mechanism, dict) else None
    return _finding(item, _number(item.before.get("stiffness_n_mm")), read, above)


def _finding(
    item: Entry, believed: float | None, figures: Mapping[str, Uncertain | None], above: float | None
) -> _Finding | None:
    tension_n = _number(item.figures.get("tension_n"))
    if believed is None or believed <= 0.0 or tension_n is None:
        return None
    lowest = {"delay_s": 0.0, "damping_n_s_mm": 0.0}
    good = {
        name: figure
        for name, figure in figures.items()
        if figure is not None and (figure.value > 0.0 or figure.value >= lowest.get(name, math.inf))
    }
    stroke_mm = _number(item.figures.get("stroke_mm"))
    return _Finding(item, tension_n, believed, good, above if above is not None and above > 0.0 else None, stroke_mm)


def _merged(group: Sequence[_Finding], spring: str) -> Identified:
    """One operating point: each figure from the first of ``group`` that has it."""
    used: list[_Finding] = []

    def first(name: str) -> Uncertain | None:
        item = next((item for item in group if name in item.figures), None)
        if item is None:
            return None
        used.append(item)
        return item.figures[name]

    def needed(name: str, title: str) -> Uncertain:
        if (figure := first(name)) is None:
            raise NotIdentifiedError(f"the {title} {spring} is not on record: run `rigctl identify` under tension")
        return figure

    stiffness = needed("stiffness_n_mm", "stiffness")
    lag, delay = needed("lag_s", "drive's lag"), needed("delay_s", "drive's delay")
    damping, ratio = first("damping_n_s_mm"), first("mechanism_damping")
    above = next((item for item in group if item.above_n_mm is not None), None)
    resonant = next((item for item in group if "mechanism_n_mm" in item.figures), None)
    if resonant is not None and (above is None or resonant.at >= above.at):
        mechanism, bound = first("mechanism_n_mm"), None
    else:
        mechanism, bound = None, above.above_n_mm if above is not None else None
        used += [above] if above is not None else []
    when = min(used, key=lambda item: item.at).entry.when
    digests = tuple(dict.fromkeys(entry_digest(item.entry) for item in used))
    tension_n, believed = group[0].tension_n, group[0].believed_n_mm
    stroke_mm = group[0].stroke_mm
    return Identified(
        when, digests, tension_n, believed, stiffness, lag, delay, mechanism, bound, stroke_mm, damping, ratio
    )  # fmt: skip


def _about(figure: Uncertain, half: float, name: str) -> Range:
    """The range about a figure; a delay may be zero, nothing else reaches it."""
    low = figure.value - half
    return Range(max(low, 0.0) if name == "delay_s" else max(low, 0.1 * figure.value), figure.value + half)


def _measured_ms(figures: Mapping[str, Any]) -> Uncertain | None:
    """The larger measured Ms of a response; None of one that was predicted."""
    margins = figures.get("margins")
    if not isinstance(margins, dict) or margins.get("measured") is not True:
        return None
    pairs = (_pair(*_value_error(margins.get(name))) for name in ("ms_input", "ms_output"))
    return max((pair for pair in pairs if pair is not None), default=None)


def _value_error(found: object) -> tuple[object, object]:
    return (found.get("value"), found.get("error")) if isinstance(found, dict) else (None, None)


def _pair(value: object, error: object) -> Uncertain | None:
    number, spread = _number(value), _number(error)
    return Uncertain(number, spread) if number is not None and spread is not None and spread >= 0.0 else None


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _same_point(a: _Finding | Identified, b: _Finding | Identified) -> bool:
    if a.stroke_mm is not None and b.stroke_mm is not None and abs(a.stroke_mm - b.stroke_mm) > SAME_STROKE_MM:
        return False
    return abs(a.tension_n - b.tension_n) <= SAME_POINT * max(abs(a.tension_n), abs(b.tension_n))
