"""The laws held to the same limits: each tuned by one optimiser for the plant as identified, then played as ever.

What a published rule asks for says nothing of Ms over a family or of the command's noise, so that laws tuned by rules
cannot be compared by their errors alone. Here every law has the same knowledge (the identified plant and its family),
the same limits (`design.ms_max`, `design.command_noise_max_mm_s`) and the same searches for the least error. Whether
the limit of Ms holds on the rig as built, which no search sees, is measured there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from hil.scenario.play import play
from hil.studies.compare import identification
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import judge
from hil.studies.compare.measured_ms import Peak, measured
from hil.studies.compare.rivals import OURS
from hil.studies.compare.rivals.feedback import Newest, Rival
from hil.studies.compare.rivals.tunable import TUNABLE
from hil.studies.compare.tuned_laws import TunedLaw, from_lqi, most_knobs, tuned
from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.design import identified
from rigctl.design.gains import design
from rigctl.design.identified import Identified
from rigctl.design.knobs import one_setting, with_weights
from rigctl.design.margins import design_and_check
from rigctl.design.plant_family import Family
from rigctl.design.verdict import Design

COMPARED = (*TUNABLE, OURS)
GRAVITY = 9.80665
Say = Callable[[str], None]


class RunErrors(NamedTuple):
    """A law in a run; None where the run did not reach its end. ``micro_g``: rms of the residual acceleration."""

    eta_max_pct: float | None
    eta_rms_pct: float | None
    settle_s: float | None
    micro_g: float | None
    ended: str


class Known(NamedTuple):
    """A rig after its identification."""

    settings: RigSettings
    plant: Identified
    family: Family

    @classmethod
    def of(cls, rig: RigSettings, found: Identified | None = None) -> Known:
        """``found``: what the identification gives; None for the truth with its uncertainty."""
        found = found or identification.exact(rig)
        believed = one_setting(identified.believing(rig, found))
        return cls(believed, found, identified.family(believed, found))

    @property
    def in_key(self) -> str:
        """The plant in the key of a row: no two rigs are identified alike to six digits."""
        plant, mechanism = self.settings.plant, self.plant.mechanism_n_mm
        k_m = "rigid" if mechanism is None else f"{mechanism.value:.6g}"
        return f"{plant.stiffness_n_mm:.6g} {plant.cylinder_lag_s:.6g} {plant.command_delay_s:.6g} {k_m}"


def identified_by(settings: RigSettings, name: str, rows: RowsFile) -> Identified:
    """What an identification finds of a rig; it is kept by ``name``."""
    key = f"identified {name}"
    kept = rows.get(key) or rows.put(key, identification.played(settings).as_dict())
    return Identified.of(kept)


def tuning(
    known: Known, law: str, rows: RowsFile, base: TunedLaw | None = None, name: str | None = None,
    designs: int | None = None, linear: bool = False,
) -> TunedLaw:  # fmt: skip
    """The tuning of a law for a rig.

    Where a local search finds nothing within the limits, the whole range is searched. Our law can be made LQI, so that
    one of its searches begins at LQI's optimum.

    Args:
        known: the rig after its identification.
        law: a name of `COMPARED`.
        rows: what is kept of the study.
        base: the tuning for another rig, at which a local search begins.
        name: under which the tuning is kept, by default the law's.
        designs: tried for each knob and start; None: as `tuned_laws.EVALUATIONS`.
        linear: as in `tuned`.
    """
    key = f"tune {name or law} {known.in_key}"
    kept = rows.get(key)
    if kept is None:
        start = base.values if base is not None and base.within else None
        count = None if designs is None else designs * most_knobs(law, known.settings)
        found = None if start is None else tuned(
            known.settings, known.family, law, start, evaluations=count, linear=linear
        )  # fmt: skip
        if found is None or not found.within:
            mapped = None
            if law == OURS:
                mapped = from_lqi(known.settings, tuning(known, "lqi", rows, designs=designs).values)
            found = tuned(known.settings, known.family, law, evaluations=count, mapped=mapped, linear=linear)
        kept = rows.put(key, {name: plain(value) for name, value in found._asdict().items()})
    cost, ms, noise = (_number(kept[name]) for name in ("cost", "ms", "command_noise_mm_s"))
    return TunedLaw(law, tuple(kept["values"]), kept["within"], cost, ms, noise, tuple(map(_number, kept["costs"])))


def _number(kept: float | None) -> float:
    return math.inf if kept is None else kept


def spread_in_words(law: TunedLaw) -> str:
    """``within 2.1 %``, or how many of the starts found nothing within the limits."""
    if law.spread_pct is not None:
        return f"within {law.spread_pct:.1f} %"
    return f"of which {sum(not math.isfinite(cost) for cost in law.costs)} found nothing within the limits"


class LoopLaw(NamedTuple):
    """What the loop runs: the settings it believes, our gains, and a factory where the law is not ours."""

    settings: RigSettings
    gains: Gains
    factory: Callable[[RigSettings, Gains, Inbox], TensionLaw] | None = None
    levels: tuple[float, ...] = (1.0,)
    """Of the filter, at which Ms is measured: both ends and the design's worst, where ours has two settings."""


def our_design(known: Known, values: Sequence[float]) -> tuple[RigSettings, Design]:
    """Our law with the values of its knobs: the settings of the loop, and the judged design."""
    used = with_weights(known.settings, values)
    return used, design_and_check(used, known.family)


def loop_law(known: Known, law: TunedLaw) -> LoopLaw:
    """A tuned law for the loop."""
    if law.name == OURS:
        used, designed = our_design(known, law.values)
        levels = tuple(sorted({0.0, 1.0, designed.worst_level})) if used.estimator.adapts else (1.0,)
        return LoopLaw(used, designed.gains, levels=levels)
    make = TUNABLE[law.name].make

    def rival(settings: RigSettings, gains: Gains, inbox: Inbox) -> TensionLaw:
        return Rival(settings, gains, Newest(inbox.cell, inbox.drive, inbox.slope), make(settings, law.values))

    return LoopLaw(known.settings, design(known.settings), rival)


def peak_by(settings: RigSettings, known: Known, law: str, runs: LoopLaw, rows: RowsFile) -> Peak | None:
    """`peak_of` a law that is tuned for what is known of the rig; it is kept in ``rows``."""
    key = f"ms {law} {known.in_key}"
    kept = rows.get(key)
    if kept is None:
        peak = peak_of(settings, runs)
        kept = rows.put(key, {} if peak is None else peak._asdict())
    return Peak(**kept) if kept else None


def peak_of(settings: RigSettings, runs: LoopLaw) -> Peak | None:
    """Ms measured on the rig of ``settings``; None where it does not stay in COMPENSATING meanwhile."""
    try:
        return measured(settings, runs.settings, runs.gains, runs.levels, runs.factory)
    except ScenarioError as error:
        if error.exit_code != 1:
            raise
        return None


def played(settings: RigSettings, law: LoopLaw, run: ComparedRun) -> RunErrors:
    """One run on the rig of ``settings``; the loop believes those of ``law``."""
    try:
        result = play(
            settings, run.tracks, seconds=run.seconds, controller="loop", target_n=settings.tension.target_n,
            gains=law.gains, law=law.factory, believed=law.settings,
        )  # fmt: skip
    except ScenarioError as error:
        if error.exit_code != 1:
            raise
        return RunErrors(None, None, None, None, str(error).removeprefix(f"{settings.rig}: "))
    found = judge(result, run, settings.tension.speed_max_mm_s)
    return RunErrors(
        found.eta_max_pct, found.eta_rms_pct, found.settle_s, micro_g(settings, found.eta_rms_pct), found.ended
    )


def micro_g(settings: RigSettings, eta_pct: float | None) -> float | None:
    """The acceleration that an error of the vertical force gives the payload, in millionths of g."""
    if eta_pct is None:
        return None
    return 1e6 * 0.01 * eta_pct * settings.tension.target_n / (settings.plant.payload_kg * GRAVITY)


def plain(value: Any) -> Any:
    """As a JSON value: an infinite figure becomes null."""
    if isinstance(value, tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
