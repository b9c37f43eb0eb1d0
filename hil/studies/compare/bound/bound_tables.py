"""The table of our law against the bound."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from hil.runs.result_table import table
from hil.studies.compare.bound.study import BoundRow, Joint, Ours
from rigctl.config.settings import RigSettings


def show_bound(rig: RigSettings, rows: Sequence[BoundRow], joint: Joint | None, console: Console) -> None:
    """Print bound, ours over it, and the price of the family, by disturbance."""
    design, pct = rig.design, 100.0 / rig.tension.target_n
    console.print(
        f"Least true error of any linear law on the nominal plant, Ms at most {design.ms_max:g}, command noise at most "
        f"{design.command_noise_max_mm_s:g} mm/s rms;\nours tuned for that plant alone and over the family of the "
        "identified one; rms / largest with 3.3 sigma of noise, %", highlight=False,
    )  # fmt: skip

    def pair(rms_n: float | None, largest_n: float | None) -> str:
        if rms_n is None:
            return "-"
        return f"{pct * rms_n:.4f}" + ("" if largest_n is None else f" / {pct * largest_n:.4f}")

    def ours(one: Ours, row: BoundRow) -> tuple[str, str]:
        return pair(one.rms_n, one.largest_n), f"{one.rms_n / row.bound_rms_n:.2f}"

    found = table(
        "disturbance", ("bound", "with inclination", "ours alone", "/ bound", "ours, family", "/ bound",
                        "price of family", "played"),
    )  # fmt: skip
    for row in rows:
        found.add_row(
            row.name, pair(row.bound_rms_n, row.bound_largest_n), pair(row.aided_rms_n, row.aided_largest_n),
            *ours(row.alone, row), *ours(row.family, row), f"{row.family.rms_n / row.alone.rms_n:.2f}",
            pair(row.played_rms_n, row.played_largest_n),
        )  # fmt: skip
    if rows:
        console.print(found, highlight=False)
    if joint is not None:
        console.print(
            f"all of heave, shakes and jolt by one law: ours / bound {1.0 / joint.alone:.2f} alone, "
            f"{1.0 / joint.family:.2f} over the family", highlight=False,
        )  # fmt: skip
    for row in rows:
        if row.below:
            console.print(f"{row.name}: ours is below the bound: the bound is wrong", highlight=False)
