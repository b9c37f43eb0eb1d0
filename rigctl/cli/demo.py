"""Output of ``rigctl demo``: a line a second, then the summary."""

from __future__ import annotations

import pathlib

from rich.console import Console
from rich.table import Table

from rigctl.config.settings import DemoSettings, RigSettings
from rigctl.demo.live_rig import own
from rigctl.demo.script import Moment, PausedError, Show
from rigctl.demo.summary import Summary, rows
from rigctl.ipc.runtime_folder import daemons
from rigctl.metrics.tension_error import error_pct
from rigctl.model.states import Mode

GIVES_WAY = 20
"""Priorities below a daemon's loop; the simulated rig runs 10 below the loop it serves."""


def run(
    settings: RigSettings, demo: DemoSettings, console: Console, recordings: pathlib.Path, *, lockstep: bool
) -> Summary:
    """Play the demo and print it. ``recordings``: folder for its recording.

    Where this computer twice stops loop or simulated rig for longer than the rig tolerates, it is played in simulated
    time.

    Raises:
        DemoError: the demo could not be played to its end.
    """
    shown = settings.rig
    settings = own_settings(settings, recordings)

    def begin(how: str) -> None:
        console.print(
            f"[bold]{shown}[/]: arm, tension to {settings.tension.target_n:g} N, {demo.angle_deg:g} deg out and "
            f"back at {demo.speed_deg_s:g} deg/s, release, disarm ({how})",
            highlight=False,
        )

    def show(moment: Moment, step: str) -> None:
        console.print(_line(moment, step), highlight=False, soft_wrap=True)

    summary = None
    if not lockstep:
        begin("real time")
        where = f"rigctl watch --connect {settings.telemetry.listen}"
        console.print(f"its own daemon is {settings.rig}: {where}", highlight=False, soft_wrap=True)
        summary = _in_real_time(settings, demo, show, console)
    if summary is None:
        from rigctl.demo.lockstep import play_lockstep

        begin("simulated time")
        summary = play_lockstep(settings, demo, show)
    _print_summary(summary, demo, console)
    return summary


def _in_real_time(settings: RigSettings, demo: DemoSettings, show: Show, console: Console) -> Summary | None:
    """The demo in real time; None where this computer has no time for it, as two tries have shown."""
    from rigctl.demo.live import play_live

    for then in ("once more", "now in simulated time, which needs no real time"):
        try:
            return play_live(settings, demo, show)
        except PausedError as error:
            console.print(f"{error}, and the rig tripped, as it should; {then}", highlight=False, soft_wrap=True)
    return None


def own_settings(settings: RigSettings, recordings: pathlib.Path) -> RigSettings:
    """The demo's settings, see `rigctl.demo.live_rig.own`; its recording goes to ``recordings``.

    Beside a daemon on this computer, whose loop may hold a load, the demo's loop runs at a lower priority.
    """
    played = own(settings, "demo")
    changes: dict[str, object] = {"recording": played.recording.model_copy(update={"folder": str(recordings)})}
    if daemons() and played.loop.priority:
        priority = max(1, played.loop.priority - GIVES_WAY)
        changes["loop"] = played.loop.model_copy(update={"priority": priority})
    return played.model_copy(update=changes)


def _line(moment: Moment, step: str) -> str:
    error = error_pct(moment.vertical_n, moment.target_n)
    shown = f"{error:+8.4f} %" if moment.mode is Mode.COMPENSATING else "         -"
    late = f"  late p99 {moment.lateness_p99_us:4.0f} us" if moment.lateness_p99_us else ""
    return (
        f"{moment.t_s:6.1f} s  {moment.mode.name:<12}  {moment.vertical_n:7.2f} N  {shown}  "
        f"stroke {moment.stroke_mm:6.2f} mm  lag {moment.tangential_deg:+5.2f} deg{late}  {step}"
    )


def _print_summary(summary: Summary, demo: DemoSettings, console: Console) -> None:
    title = f"demo, {summary.duration_s:g} s{'' if summary.real_time else ' of simulated time'}"
    table = Table("", "measured", "limit", "", title=title, title_justify="left", box=None)
    for name, measured, limit, met in rows(summary, demo):
        mark = "" if met is None else "[green]met[/]" if met else "[bold red]NOT MET[/]"
        table.add_row(name, measured, limit, mark)
    console.print(table, highlight=False)
    if summary.recording is not None:
        console.print(f"recording: {summary.recording}", highlight=False, markup=False, soft_wrap=True)
    console.print("[bold green]passed[/]" if summary.passed else "[bold red]FAILED[/]")
