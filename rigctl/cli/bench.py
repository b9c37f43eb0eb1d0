"""``rigctl bench FILE``: measure, show, judge."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import BAD, DONE, USAGE, Json, end, load_rig_file, number_option, say_json
from rigctl.config.typed_number import TypedNumber

if TYPE_CHECKING:
    from rich.console import Console

    from rigctl.bench.loop import RateResult
    from rigctl.config.settings import RigSettings

LATENESS_RATIO = 2.0
"""The loop's lateness p99.9 over cyclictest's."""
SKIPPED_PER_LATE = 3
"""Periods the loop may skip for each late wake-up of cyclictest."""
_LONGEST_S, _SHORTEST_S = 3600.0, 1.0

File = Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Rig file.", autocompletion=rig_files)]
Seconds = Annotated[
    float,
    number_option(
        TypedNumber("seconds", _SHORTEST_S, _LONGEST_S), "--seconds", metavar="S",
        help="Of the loop at each rate, and as many of cyclictest.",
    ),
]  # fmt: skip
Rates = Annotated[
    list[int] | None,
    number_option(TypedNumber("hertz", whole=True), "--rate", metavar="HZ", help="Loop rate, several [the file's]."),
]


def bench(file: File, seconds: Seconds = 30.0, rate: Rates = None, json: Json = False) -> None:
    """Measure how well this computer keeps the loop's time, on the simulated rig; the real one is not touched.

    Exit code 0 if every tick has its time, 1 if not, or while a daemon runs here.
    """
    _check(rate or [])
    settings = _settings(file)
    from rich.console import Console

    from rigctl.bench import loop
    from rigctl.cli.progress import progress
    from rigctl.demo.live_rig import LiveRigError

    _check_alone()
    rates = list(dict.fromkeys(rate or [settings.loop.rate_hz]))
    try:
        with progress("bench", 2.0 * seconds * len(rates)) as advance:
            measured = [loop.measure(settings, rate_hz, seconds, advance) for rate_hz in rates]
    except LiveRigError as error:
        end(BAD, f"bench: {error}")
    except KeyboardInterrupt:
        end(BAD, "bench interrupted: its daemon and its simulated rig are ended")
    if json:
        verdicts = [{"name": name, "figure": figure, "limit": limit, "met": met} for name, figure, limit, met in
                    (row for one in measured for row in judged(one))]  # fmt: skip
        say_json({"rates": {str(one.rate_hz): one.as_dict() for one in measured}, "verdicts": verdicts})
    else:
        show(measured, Console())
    raise typer.Exit(DONE if all(met for one in measured for *_, met in judged(one)) else BAD)


def _check(rates: list[int]) -> None:
    for rate_hz in rates:
        if not 100 <= rate_hz <= 4000 or rate_hz % 100 or 1_000_000_000 % rate_hz:
            end(USAGE, f"--rate: found {rate_hz}, expected 100 to 4000, a multiple of 100 of whole nanoseconds")


def _settings(file: pathlib.Path) -> RigSettings:
    settings = load_rig_file(file)
    if settings.simulation is None:
        end(USAGE, f"{file}: simulation: found nothing, expected a section (the bench needs it)")
    return settings


def _check_alone() -> None:
    """Refuse to run beside a daemon, whose loop may hold a load and would lose processor time."""
    from rigctl.ipc.runtime_folder import daemons

    if running := [f"{rig} (process {pid})" for rig, pid in daemons()]:
        end(BAD, f"bench: a daemon runs on this computer, and its loop comes first: {', '.join(running)}")


def judged(rate: RateResult) -> list[tuple[str, float, float, bool]]:
    """Name, figure, limit and result of every criterion of a rate."""
    loop, other = rate.loop, rate.cyclictest
    busy_us = loop["lateness_us"]["p999"] + loop["work_us"]["p999"]
    rows: list[tuple[str, float, float]] = [
        (f"{rate.rate_hz} Hz: lateness and work, p99.9, us", busy_us, rate.period_us),
        (f"{rate.rate_hz} Hz: periods skipped", loop["skipped_ticks"],
         SKIPPED_PER_LATE * other["later_than_a_period"] if other else 0),
        (f"{rate.rate_hz} Hz: ticks not compensating", loop["ticks_not_compensating"], 0),
    ]  # fmt: skip
    if (ratio := rate.lateness_p999_ratio) is not None:
        rows.append((f"{rate.rate_hz} Hz: lateness p99.9 over cyclictest's", ratio, LATENESS_RATIO))
    return [(name, round(figure, 2), limit, figure <= limit) for name, figure, limit in rows]


def show(measured: list[RateResult], console: Console) -> None:
    """Print percentiles of every rate, and the verdicts."""
    from rich.table import Table

    console.print(table(measured), highlight=False)
    if any(one.cyclictest is None for one in measured):
        console.print("cyclictest is not installed (Debian package rt-tests) or not permitted: nothing to compare with")
    verdicts = Table("", "measured", "limit", "", box=None)
    for one in measured:
        for name, figure, limit, met in judged(one):
            verdicts.add_row(name, f"{figure:g}", f"{limit:g}", "[green]met[/]" if met else "[bold red]NOT MET[/]")
    console.print(verdicts, highlight=False)


def table(measured: list[RateResult]) -> Any:
    """Table of percentiles, three or four rows for each rate."""
    from rich.table import Table

    from rigctl.metrics.tension_error import PERCENTILES

    def numbers(values: dict[str, float]) -> list[str]:
        return [f"{values[name]:>6.0f}" for name in PERCENTILES]

    shown = Table("Hz", "us", *(f"{name:>6}" for name in PERCENTILES), "missed periods", box=None)
    for one in measured:
        shown.add_row(str(one.rate_hz), "loop, work", *numbers(one.loop["work_us"]), "")
        shown.add_row("", "loop, lateness", *numbers(one.loop["lateness_us"]), f"{one.loop['skipped_ticks']}")
        if one.cyclictest is not None:
            late = f"{one.cyclictest['later_than_a_period']}"
            shown.add_row("", "cyclictest", *numbers(one.cyclictest["lateness_us"]), late)
            shown.add_row("", "ratio of p99.9", "", "", f"{one.lateness_p999_ratio:>6.2f}")
    return shown
