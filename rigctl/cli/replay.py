"""``rigctl replay``: plays a recording through the loop again and compares the result with the recording."""

from __future__ import annotations

import gc
import pathlib
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.options import BAD, DONE, USAGE, Json, check_output, end, load_rig_file, say, say_json
from rigctl.cli.recordings import read_recording
from rigctl.model.quantity import count

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings
    from rigctl.control.law.tension import Gains
    from rigctl.recorder.recording import Recording
    from rigctl.replay.compare import Against, Divergence
    from rigctl.replay.play import ProcessSpan
    from rigctl.report.culprits import RecordedCulprit

_COLUMNS = ("ticks", "then_rms_mm_s", "now_rms_mm_s", "apart_rms_mm_s", "apart_max_mm_s")


def replay(
    file: Annotated[
        pathlib.Path,
        typer.Argument(metavar="FILE", help="A part of a recording (the run's others are taken too), or a run's name."),
    ],
    against: Annotated[
        pathlib.Path | None, typer.Option(metavar="RIGFILE", help="What would this rig file's tuning have commanded?")
    ] = None,
    plot: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="With --against: draw both commands: png, svg, pdf.")
    ] = None,
    json: Json = False,
) -> None:
    """Play a recording through the loop again: every command and mode bit-identical, or the first that is not."""
    if plot is not None and against is None:
        end(USAGE, "--plot draws what --against compares; give both")
    check_output("--plot", plot)
    recording, spans = _read(file)
    gc.freeze()  # spares the collector the recording, none of which is garbage
    if against is not None:
        _against(recording, spans, against, plot, json=json)
    else:
        _again(file, recording, spans, json=json)


def _read(file: pathlib.Path) -> tuple[Recording, list[ProcessSpan]]:
    from rigctl.replay.play import ReplayError, spans

    recording = read_recording([file], whole_run=True)
    try:
        return recording, spans(recording)
    except ReplayError as error:
        end(USAGE, f"{file}: {error}")


def _again(file: pathlib.Path, recording: Recording, spans: list[ProcessSpan], *, json: bool) -> None:
    from rigctl.cli.progress import progress
    from rigctl.ipc import ledger
    from rigctl.recorder.contents import seals_in_words
    from rigctl.replay.compare import first_difference
    from rigctl.replay.play import made_by, play

    found: list[dict[str, Any]] = []
    start = time.monotonic()
    bad = cut = False
    for number, span in enumerate(spans, 1):
        with progress("replay", len(span.records)) as advance:
            same, divergence = first_difference(play(recording, span), advance)
        bad |= divergence is not None
        cut |= bool(span.cut_short)
        shown = _shown(divergence, recording.wall_offset_ns) if divergence is not None else None
        found.append(
            {"loop": number, "ticks": len(span.records), "same": same, "first_difference": shown,
             "cut_short": span.cut_short}
        )  # fmt: skip
    sealed = seals_in_words(recording)
    named = [one for span in spans for one in _culprits(recording, span)]
    passed_s = time.monotonic() - start
    recorded_s = sum(row["ticks"] for row in found) / spans[0].settings.loop.rate_hz
    times = recorded_s / passed_s if passed_s else 0.0
    if json:
        say_json(
            {
                "file": str(file),
                "seal": sealed,
                "release": recording.release,
                "loops": found,
                "identical": not bad,
                "culprits": [{"t_ns": one.t_ns, **one.culprit.as_message()} for one in named],
                "times_real_time": times,
            }
        )
    else:
        say(f"seal: {sealed}")
        for row in found:
            _say_row(row, many=len(found) > 1)
        for one in named:
            say(f"culprit at {ledger.utc(one.t_ns + recording.wall_offset_ns)}: {one.culprit.words}")
        say(f"{recorded_s:.1f} s of loop replayed at {times:.1f} times real time")
    if bad or cut:
        what = "a command, a mode or a figure came out differently" if bad else "the recording has a gap"
        other = made_by(recording) if bad else ""
        end(BAD, f"{file}: {what}{'; ' if other else ''}{other}")
    end(DONE)


def _culprits(recording: Recording, span: ProcessSpan) -> list[RecordedCulprit]:
    """Of the trips of one control process, by its own settings."""
    from rigctl.report.culprits import culprits

    first_ns, last_ns = int(span.records["t_ns"][0]), int(span.records["t_ns"][-1])
    return [one for one in culprits(recording, span.settings) if first_ns <= one.t_ns <= last_ns]


def _shown(divergence: Divergence, offset_ns: int) -> dict[str, Any]:
    from rigctl.ipc import ledger

    return {
        "t_ns": divergence.t_ns,
        "utc": ledger.utc(divergence.t_ns + offset_ns),
        "tick": divergence.tick,
        "fields": {row.field: {"then": row.then, "now": row.now} for row in divergence.differences},
    }


def _say_row(row: dict[str, Any], *, many: bool) -> None:
    name = f"loop {row['loop']}: " if many else ""
    if (first := row["first_difference"]) is None:
        say(f"{name}{count(row['ticks'], 'tick')} bit-identical: commands, modes, frames sent, every recorded figure")
    else:
        say(f"{name}{count(row['same'], 'tick')} the same; first difference in tick {first['tick']} at {first['utc']}:")
        for field, both in first["fields"].items():
            say(f"  {field:24}  then {both['then']}")
            say(f"  {'':24}  now  {both['now']}")
    if row["cut_short"]:
        say(f"{name}the recording goes on, but {row['cut_short']} there: not replayed from here")


def _against(
    recording: Recording, spans: list[ProcessSpan], file: pathlib.Path, plot: pathlib.Path | None, *, json: bool
) -> None:
    from rigctl.cli.progress import progress
    from rigctl.replay.compare import Against
    from rigctl.replay.play import play

    settings, gains = _other(file, spans[0])
    found = Against()
    for span in spans:
        with progress("replay", len(span.records)) as advance:
            for batch in play(recording, span, settings, gains):
                found.add(batch)
                advance(len(batch.recorded), "")
    if plot is not None:
        from rigctl.replay.picture import draw

        title = f"{recording.files[0].path.name}: commands as given, and with {file.name}"
        draw(found, plot, title, settings.tension.speed_max_mm_s)
    if json:
        say_json(_document(found))
    else:
        _say_against(found, file, spans[0], gains, recording.wall_offset_ns)
        if plot is not None:
            say(f"written: {plot}")
    end(DONE)


def _other(file: pathlib.Path, span: ProcessSpan) -> tuple[RigSettings, Gains]:
    from rigctl.design.gains import DesignError
    from rigctl.design.in_use import adopted, design_in_use

    settings = load_rig_file(file)
    if settings.loop.rate_hz != span.settings.loop.rate_hz:
        end(USAGE, f"{file}: loop.rate_hz: found {settings.loop.rate_hz}, recorded with {span.settings.loop.rate_hz}")
    if settings.canopen_nodes != span.settings.canopen_nodes or settings.plain_messages != span.settings.plain_messages:
        end(
            USAGE,
            f"{file}: its devices are not those recorded: {settings.canopen_nodes}, {span.settings.canopen_nodes}",
        )
    try:
        return adopted(settings), design_in_use(settings).gains
    except (DesignError, ArithmeticError, ValueError) as error:
        end(USAGE, f"{file}: no design: {error}")


def _document(found: Against) -> dict[str, Any]:
    other, fault = found.first_other_mode, found.first_fault
    return {
        "modes": found.rows(),
        "other_mode_ticks": found.other_mode_ticks,
        "first_other_mode": None if other is None else {"t_ns": other[0], "then": other[1].name, "now": other[2].name},
        "first_fault": None if fault is None else {"t_ns": fault[0], "fault": _fault(fault[1])},
    }


def _fault(number: int) -> str:
    from rigctl.model.faults import Fault

    return Fault(number).name


def _say_against(found: Against, file: pathlib.Path, span: ProcessSpan, gains: Gains, offset_ns: int) -> None:
    from rigctl.ipc import ledger

    say(f"what {file} would have commanded, had the rig done what it did then (nothing of it moved anything):")
    say("              k_tension   k_speed  k_integral")
    for name, values in (("then", span.gains), ("now", gains)):
        say(f"  {name:8}  {values.k_tension:11.5g} {values.k_speed:9.5g} {values.k_integral:11.5g}")
    say(f"  {'mode':14} {'ticks':>8}  {'then rms':>9} {'now rms':>9} {'apart rms':>9} {'apart max':>9}  mm/s")
    for row in found.rows():
        ticks, *figures = (row[name] for name in _COLUMNS)
        say(f"  {row['mode']:14} {ticks:8}  " + " ".join(f"{figure:9.4f}" for figure in figures))
    if (other := found.first_other_mode) is not None:
        say(
            f"other mode in {count(found.other_mode_ticks, 'tick')}, first at {ledger.utc(other[0] + offset_ns)}: "
            f"{other[1].name} then, {other[2].name} now"
        )
    if (fault := found.first_fault) is not None:
        say(f"would have tripped at {ledger.utc(fault[0] + offset_ns)}: {_fault(fault[1])}")
