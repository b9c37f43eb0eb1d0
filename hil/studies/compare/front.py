"""The front of error against Ms: the least error of each law's structure at each limit of Ms, same noise, same plant.

The laws tuned by their published rules and ours with the weights of the rig file are drawn beside it as points: a point
above its law's front leaves error on the table, one to the right of the limit is not allowed.
"""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.runs.rows_file import RowsFile
from hil.studies import plotting
from hil.studies.compare import tuned_laws
from hil.studies.compare.comparison_charts import COLORS
from hil.studies.compare.equal_limits import Known, tuning
from hil.studies.compare.rivals import LAWS, OURS
from hil.studies.compare.tuned_laws import FamilyResponses, TunedLaw
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design import optimise

MS_LIMITS = (1.3, 1.4, 1.6, 1.8, 2.2)
WIDEST_MS = 2.4  # drawn; what lies beyond is named at the edge
Say = Callable[[str], None]


class FrontPoint(NamedTuple):
    """A law at a limit of Ms; ``limit`` None: with the values of its rule or of the rig file."""

    law: str
    limit: float | None
    ms: float
    share: float | None
    """Largest over the groups of error over what one law reaches; None where no parameters keep the limits."""
    command_noise_mm_s: float


def points(rig: RigSettings, laws: Sequence[str], rows: RowsFile, say: Say) -> list[FrontPoint]:
    """Every law at every limit, and as it is."""
    found = []
    for law in laws:
        base: TunedLaw | None = None
        for limit in sorted(MS_LIMITS, key=lambda ms: abs(ms - rig.design.ms_max)):
            known = Known.of(changed(rig, {"design.ms_max": limit}))
            mine = tuning(known, law, rows, base, name=f"{law} Ms {limit:g}")
            base = base or mine
            error = math.exp(mine.cost) if math.isfinite(mine.cost) else None
            found.append(FrontPoint(law, limit, mine.ms, error, mine.command_noise_mm_s))
            say(f"{law}, Ms at most {limit:g}: " + ("none" if error is None else f"error x {error:.3f}"))
        found.append(as_it_is(Known.of(rig), law))
    return found


def as_it_is(known: Known, law: str) -> FrontPoint:
    """A law by its published rule, ours with the weights of the rig file; no limit is applied."""
    settings = known.settings
    wide = optimise.Limits(math.inf, math.inf, math.inf)
    if law == OURS:
        judged: optimise.Judged | None = optimise.our_design(settings, known.family)
    else:
        make = LAWS[law].make
        assert make is not None  # rivals have one
        judged = tuned_laws.judged(settings, lambda: make(settings), FamilyResponses(settings, known.family))
    score = optimise.score(settings, judged, wide, None)
    error = math.exp(score.cost) if score.within else None
    return FrontPoint(law, None, score.ms, error, score.command_noise_mm_s)


def draw(rig: RigSettings, found: Sequence[FrontPoint], file: pathlib.Path) -> None:
    """Write the picture.

    Raises:
        OutputError: it cannot be written.
    """
    figure, ((axis,),) = plotting.panels(1, 1, (9.0, 5.6))
    for law in dict.fromkeys(point.law for point in found):
        title, colour = LAWS[law].title, COLORS[law]
        line = sorted((p.ms, p.share) for p in found if p.law == law and p.limit is not None and p.share)
        axis.plot(*zip(*line, strict=True), "o-", color=colour, markersize=3.5, label=title,
                  linewidth=2.2 if law == OURS else 1.2)  # fmt: skip
        for p in found:
            if p.law == law and p.limit is None and p.share and math.isfinite(p.ms):
                beyond, at = p.ms > WIDEST_MS, min(p.ms, WIDEST_MS)
                axis.plot([at], [p.share], ">" if beyond else "x", color=colour, markersize=8, markeredgewidth=1.8)
                words = f"{title}, noise {p.command_noise_mm_s:.2f}" + (f", Ms {p.ms:.1f}" if beyond else "")
                below = p.ms > rig.design.ms_max  # beside the limit two of them are close
                axis.annotate(words, (at, p.share), textcoords="offset points", fontsize=7.5, color=colour,
                              xytext=(-6 if beyond else 6, -10 if below else 5),
                              ha="right" if beyond else "left")  # fmt: skip
    axis.axvline(rig.design.ms_max, color="#d00000", linewidth=1.0, label=f"limit, Ms {rig.design.ms_max:g}")
    axis.plot([], [], "kx", label="by its rule, ours by the rig file")
    axis.set_xlim(right=WIDEST_MS + 0.03)
    axis.set_yscale("log")
    axis.yaxis.set_minor_formatter("{x:.2g}")
    axis.yaxis.set_major_formatter("{x:.2g}")
    noise_max = rig.design.command_noise_max_mm_s
    axis.set_title(
        f"Lines: least error within Ms and {noise_max:g} mm/s of command noise, plant as identified", fontsize=10
    )
    plotting.label(
        axis, x="Ms over the family of the identified plant", y="largest error over what one law reaches",
        which="both",
    )  # fmt: skip
    axis.legend(fontsize=8, ncols=2)
    plotting.save(figure, file)
