"""A design as text, 80 columns wide."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rigctl.config.settings import RigSettings
from rigctl.design.identified import in_words
from rigctl.design.performance import SHAKE_HZ, VERTICAL_HZ, VERTICAL_MM
from rigctl.design.plant_family import ASSUMED, REPORTED_N_MM
from rigctl.design.tuning import Tuned
from rigctl.design.verdict import Design, MemberMargins

GAINS = (
    ("k_tension", "mm/s per N", "speed per newton of tension error"),
    ("k_speed", "", "speed per speed error"),
    ("k_integral", "mm/s per N s", "speed per newton second of tension error"),
)
"""Every gain: name, unit, meaning."""
_COLUMNS = "  K_m N/mm   k      delay   Ms in   Ms out   GM dB   PM deg   DM ms"
_COLUMNS_WITH_LAG = "  K_m N/mm   k      lag    delay   Ms in   Ms out   GM dB   PM deg   DM ms"


def lines(settings: RigSettings, found: Design) -> Iterator[str]:
    """Gains, margins with every plant of the family, performance with the plant in the file, and the verdict."""
    yield f"{settings.rig}: gains"
    for name, unit, meaning in GAINS:
        yield f"  {name:<10} {getattr(found.gains, name):>10.6g}  {unit:<12}  {meaning}"
    yield ""
    yield from _margins(found)
    yield ""
    if found.reported:
        yield f"beside the family, not judged: K_m = {REPORTED_N_MM:g} N/mm"
        yield _COLUMNS
        for member in found.reported:
            yield _row(member)
        yield ""
    yield "Ms in, Ms out: peak of sensitivity at the plant's input and the tension output;"
    yield "GM, PM, DM: change of gain, phase and further delay that end stability."
    yield ""
    yield from _performance(found)
    yield ""
    if found.settings:
        each = ", ".join(f"{setting.name} {setting.ms_max:.3f}" for setting in found.settings)
        proof = "not proven" if found.switching is None else f"{found.switching:.3f}, stable above 0"
        yield f"settings of the filter, Ms: {each}"
        yield f"any change between them: circle criterion {proof}"
        yield ""
    verdict = found.verdict()
    yield f"accepted: {verdict}" if found.accepted else verdict
    for warning in found.warnings():
        yield f"WARNING: {warning}"


def origin(tuned: Tuned) -> Iterator[str]:
    """What a design takes from the ledger or from a search in place of the rig file's values."""
    if tuned.plant is not None:
        yield f"identified {tuned.plant.when[:10]}: {in_words(tuned.plant, tuned.settings)}"
    if tuned.replaces:
        yield "in place of the rig file's values:"
        for key, (was, now) in tuned.replaces.items():
            yield f"  {key}: {_plain(now)}  # was {_plain(was)}"


def _plain(value: float | None) -> str:
    return "null" if value is None else f"{value:.6g}"


def _margins(found: Design) -> Iterator[str]:
    """Every plant of the assumed family; of an identified one, with its many corners, the worst for each K_m."""
    margins, worst = found.margins, max(found.margins, key=lambda member: member.ms_worst)
    if found.family == ASSUMED:
        yield f"margins over the family: {len(margins)} plants, mechanism's stiffness K_m, rope's k, delay"
        yield _COLUMNS
        shown = list(margins)
    else:
        yield f"margins over the family {found.family}: {len(margins)} plants, the worst for each stiffness K_m"
        yield _COLUMNS_WITH_LAG
        each = dict.fromkeys(member.k_m for member in margins)
        shown = [max((m for m in margins if m.k_m == k_m), key=lambda member: member.ms_worst) for k_m in each]
    for member in shown:
        yield _row(member, "  <- worst" if member is worst and worst.stable else "", lag=found.family != ASSUMED)
    stable = [member for member in margins if member.stable]
    if stable:
        yield (
            f"  worst {'':<{19 if found.family == ASSUMED else 26}}"
            f"{max(m.ms for m in stable):>6.3f}{max(m.ms_output for m in stable):>9.3f}"
            f"{min(m.gm_db for m in stable):>8.1f}{min(m.pm_deg for m in stable):>9.1f}"
            f"{min(m.dm_ms for m in stable):>8.1f}"
        )


def _row(member: MemberMargins, mark: str = "", *, lag: bool = False) -> str:
    k_m = "rigid" if member.k_m is None else f"{member.k_m:.4g}"
    beside = f" x {member.lag_scale:<4.3g}" if lag else ""
    which = f"  {k_m:<8}   x {member.k_scale:<4.3g}{beside} x {member.delay_scale:<4.3g}"
    if not member.stable:
        return f"{which}   UNSTABLE"
    return (
        f"{which}{member.ms:>8.3f}{member.ms_output:>9.3f}{_or_none(member.gm_db):>8}"
        f"{_or_none(member.pm_deg):>9}{_or_none(member.dm_ms):>8}{mark}"
    )


def _or_none(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "inf"


def _performance(found: Design) -> Iterator[str]:
    figures = found.performance
    if figures is None:
        yield "on the plant in the file: UNSTABLE"
        return
    yield "on the plant in the file, linear, true tension:"
    moved = f"payload moved {VERTICAL_MM:g} mm up and down at {VERTICAL_HZ:g} Hz"
    yield f"  {figures.vertical_error_n:>8.3g} N     peak, {moved}"
    for hz, left in zip(SHAKE_HZ, (figures.sensitivity_3hz, figures.sensitivity_8hz), strict=True):
        yield f"  {left:>8.3g}       left of a disturbance at {hz:g} Hz, over the locked stroke's"
    yield f"  {figures.tension_noise_n:>8.3g} N     rms, from the cell's noise"
    yield f"  {figures.command_noise_mm_s:>8.3g} mm/s  rms of the command, from the cell's noise"
    yield f"  {figures.command_noise_per_speed:>8.3g}       rms of the command per rms of drive-speed noise"
