"""The tables of the groups: each law's error, what it is over the bound, its Ms, and the joint bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from rich.console import Console
from rich.table import Table

from hil.runs.result_table import table
from hil.studies.compare.bound.joint_groups import JointGroups
from hil.studies.compare.groups import LOWEST, TIED, places, seeds
from hil.studies.compare.rivals import LAWS
from hil.studies.compare.shares import Shares
from rigctl.model.quantity import count

SIGNS: Mapping[str | None, str] = {LOWEST: "*", TIED: "="}


def show(found: Shares, joint: Sequence[JointGroups], console: Console) -> None:
    """Print every figure and the headline: in how many groups each law is lowest or tied."""
    if found.groups:
        _show_groups(found, console)
    if joint:
        console.print(_joint(joint), highlight=False)


def _show_groups(found: Shares, console: Console) -> None:
    errors = {group: found.errors(group) for group in found.groups}
    place = {group: places(errors[group]) for group in found.groups}

    def error(group: str, law: str) -> str:
        one = errors[group][law]
        return "-" if one is None else f"{one.error_pct:.4f}{SIGNS.get(place[group][law], ' ')}"

    def spread(group: str, law: str) -> str:
        one = errors[group][law]
        return "-" if one is None else f"{one.spread:.3f}"

    def share(group: str, law: str) -> str:
        one = found.over_bound(group, law)
        return "-" if one is None else f"{one:.2f}"

    def peak(group: str, law: str) -> str:
        one = found.peak(group, law)
        return "-" if one is None else f"{one.ms:.2f} +- {one.error:.2f}"

    said = ", ".join(map(str, seeds(found.rig)))
    for title, figure in (
        (f"The error's root mean square, %, over seeds {said}; * lowest, = tied within the seeds' spread", error),
        ("Spread of the seeds, largest over least", spread),
        ("Error over the bound of any linear law that reads the cell", share),
        ("Ms, the largest measured", peak),
    ):
        console.print(_by_group(found, title, figure), highlight=False)
    beyond = [
        f"{law} in {group} {one.ms:.2f}"
        for group in found.groups
        for law in found.laws
        if (one := found.peak(group, law)) is not None and one.ms - one.error > found.rig.design.ms_max
    ]
    if beyond:
        console.print(f"measured Ms above {found.rig.design.ms_max:g}: {', '.join(beyond)}", highlight=False)
    missed = [f"{law} in {run}" for (run, law), row in found.played.items() if not row.within]
    if missed:
        console.print(f"no parameters within the limits: {', '.join(missed)}", highlight=False)
    headline = ", ".join(f"{LAWS[law].title} {number}" for law, number in found.counts().items())
    console.print(f"\nlowest or tied, of {count(len(found.groups), 'group')}: {headline}", highlight=False)


def _by_group(found: Shares, title: str, figure: Callable[[str, str], str]) -> Table:
    rows = table("group", [LAWS[law].title for law in found.laws], f"\n{title}")
    for group in found.groups:
        rows.add_row(group, *(figure(group, law) for law in found.laws))
    return rows


def _joint(joint: Sequence[JointGroups]) -> Table:
    """A row for each side of each joint bound; a price is what the optimum is lower by without the group."""
    groups = list(joint[0].reference_n)
    rows = table(
        "plant, memory, reference: S kept on", ("t", *groups, "Ms"),
        "\nOne law for all groups: the largest error over the reference, t; each group's, / t without the group",
    )  # fmt: skip
    for one in joint:
        for side, reach in (("nominal", one.nominal), ("family", one.family)):
            name = f"{one.plant}, {one.memory_s:g} s, {one.reference}: {side}"
            if reach is None:
                rows.add_row(name, "none", *("-" for _ in groups), "-")
                continue
            cells = (
                f"{reach.over[group]:.2f}" + (f" / {reach.without[group]:.2f}" if group in reach.without else "")
                for group in groups
            )
            rows.add_row(name, f"{reach.most:.2f}", *cells, f"{reach.ms:.2f}")
    return rows
