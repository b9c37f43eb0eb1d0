"""``rigctl info`` and ``rigctl export``: the contents of a recording, and its export for other programs."""

from __future__ import annotations

import pathlib
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.options import DONE, USAGE, Json, end, say, say_json, wrong_usage
from rigctl.cli.recorded_runs import files_named
from rigctl.model import quantity

if TYPE_CHECKING:
    from rigctl.recorder.recording import Recording


class To(Enum):
    """Formats of an export."""

    PARQUET = "parquet"
    CSV = "csv"
    MAT = "mat"
    MDF4 = "mdf4"


Files = Annotated[
    list[pathlib.Path],
    typer.Argument(metavar="FILE...", help="Recording, its parts, a trip dump, or the name of a run (rigctl runs)."),
]
Run = Annotated[bool, typer.Option("--run", help="Take every part of FILE's run, in its folder.")]
Format = Annotated[To, typer.Option("--to", help="What to write.")]
Out = Annotated[pathlib.Path, typer.Option("-o", "--out", metavar="FOLDER", help="New folder to write.")]


_LOGS = {"desk": "requests and answers"}
"""Topics whose name does not say what is in them."""


def info(files: Files, run: Run = False, json: Json = False) -> None:
    """Show what is in a recording: times, modes, events, gaps, documents, versions, and whether it is complete."""
    from rigctl.recorder.contents import figures

    found = figures(read_recording(files, whole_run=run))
    if json:
        say_json(found)
    else:
        for line in _lines(found):
            say("".join(letter if letter.isprintable() else "?" for letter in line))
    end(DONE)


def export(files: Files, to: Format, out: Out, run: Run = False) -> None:
    """Write a recording as Parquet, CSV, MAT or MDF4: a new folder with a table for each topic, units included."""
    from rigctl.ipc.output_file import OutputError
    from rigctl.recorder import export as exporting

    with wrong_usage(OutputError):
        exporting.check(out)
        written = exporting.write(read_recording(files, whole_run=run), to.value, out)
    say(f"{out}: {', '.join(name for name in written if '/' not in name)}")


def read_recording(files: list[pathlib.Path], *, whole_run: bool, frames: bool = True) -> Recording:
    """The recording in ``files``; ``whole_run``: with every part beside them. The command ends if it cannot be read."""
    from rigctl.recorder import recording

    files = [part for file in files for part in files_named(file)]
    try:
        if whole_run:
            files = sorted({part for file in files for part in recording.parts_of(file)})
        return recording.read(*files, frames=frames)
    except recording.RecordingError as error:
        end(USAGE, str(error))


def _lines(found: dict[str, Any]) -> list[str]:
    """The figures as lines of text."""
    own = found["metadata"].get("rigctl", {})
    complete = "complete" if found["complete"] else "NOT COMPLETE"
    lines = [f"{found['rig']}: {found['kind']}, {found['duration_s']:g} s, {complete}"]

    def row(label: str, text: str) -> None:
        lines.append(f"  {label:<9} {text}")

    if found["start"] is not None:
        row("from", f"{found['start']} to {found['end']}")
    row("run", f"{found['run']} on {own.get('host', '-')}, rigctl {own.get('version', '-')}")
    for file in found["files"]:
        note = f" - {file['note']}" if file["note"] else ""
        row("file", f"{file['file']}, {file['bytes'] / 1e6:.1f} MB, {file['seal']}{note}")
    row("sha256", found["sha256"])
    rate = f" at {found['rate_hz']:g} Hz" if found["rate_hz"] else ""
    frames, commands = quantity.count(found["frames"], "frame"), quantity.count(found["commands"], "command")
    row("records", f"{found['records']}{rate}, {frames}, {commands}")
    for number, mode in enumerate(found["modes"]):
        fault = f"  {mode['fault']}" if mode["fault"] else ""
        row("" if number else "modes", f"{mode['t_s']:10.3f} s  {mode['mode']:<12} {mode['for_s']:10.3f} s{fault}")
    row("log", ", ".join(f"{_LOGS.get(topic, topic)} {count}" for topic, count in found["said"].items()) or "nothing")
    row("events", ", ".join(f"{count} {what}" for what, count in found["events"].items()) or "none")
    for number, gap in enumerate(found["gaps"]):
        slots = quantity.count(gap["count"], "slot")
        row("" if number else "GAPS", f"{gap['t_s']:10.3f} s  {slots} of {gap['ring']} missing after {gap['after']}")
    if not found["gaps"]:
        row("gaps", "none")
    starts = found["control_starts_s"]
    if len(starts) > 1:
        row("restarts", "of the control process at " + ", ".join(f"{t_s:.3f} s" for t_s in starts[1:]))
    for number, item in enumerate(found["attachments"]):
        row(
            "" if number else "attached",
            f"{item['t_s']:10.3f} s  {item['name']}, {quantity.count(item['bytes'], 'byte')}",
        )
    row("versions", ", ".join(f"{name} {version}" for name, version in found["versions"].items()) or "not recorded")
    return lines
