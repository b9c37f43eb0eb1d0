"""``rigctl report``: a test report from a recording, one HTML page."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.options import BAD, DONE, USAGE, Json, check_output, end, say, say_json, wrong_usage
from rigctl.cli.recordings import read_recording
from rigctl.ipc import output_file

if TYPE_CHECKING:
    from rigctl.recorder.recording import Recording
    from rigctl.report.findings import Findings

SUFFIXES = (".html", ".htm")


def report(
    file: Annotated[
        pathlib.Path,
        typer.Argument(
            metavar="FILE", help="A part of a recording (the run's others are taken too), a trip dump, or a run's name."
        ),
    ],
    output: Annotated[
        pathlib.Path | None, typer.Option("-o", "--output", metavar="HTML", help="Where the page goes [NAME.html].")
    ] = None,
    part: Annotated[bool, typer.Option("--part", help="Report of FILE alone, not of the whole run.")] = False,
    picture: Annotated[
        pathlib.Path | None, typer.Option(metavar="SVG", help="Write the picture of the whole run, too.")
    ] = None,
    article: Annotated[str, typer.Option(metavar="TEXT", help="What was tested, for the first box.")] = "",
    test: Annotated[str, typer.Option(metavar="TEXT", help="Name or number of the test, for the first box.")] = "",
    json: Json = False,
) -> None:
    """Write a test report of a recording: verdict, charts, provenance. Exit code 1 if the verdict is not "passed"."""
    from rigctl.recorder.contents import seals_in_words

    page = output if output is not None or json else pathlib.Path(f"{file.stem}.html")
    if page is not None:
        if page.suffix.lower() not in SUFFIXES:
            end(USAGE, f"--output: found {page}, expected a name ending in {', '.join(SUFFIXES)}")
        check_output("--output", page)
    check_output("--picture", picture)
    recording = read_recording([file], whole_run=not part, frames=False)
    if page is not None and any(_same(page, own.path) for own in recording.files):
        end(USAGE, f"--output: {page} is the recording, expected a file of its own")
    found = _find(recording)
    if page is not None:
        _write(page, found, article, test)
    if picture is not None:
        from rigctl.report.page import overview

        with wrong_usage(output_file.OutputError):
            output_file.replace(picture, overview(found))
    if json:
        from rigctl.report.findings import as_dict

        say_json({**as_dict(found), "seal": seals_in_words(recording)})
    else:
        _say(found)
        say(f"seal: {seals_in_words(recording)}")
        say(f"written: {page}")
    end(DONE if found.verdict.passed else BAD, None if found.verdict.passed else f"{file}: {_complaint(found)}")


def _find(recording: Recording) -> Findings:
    from rigctl.report.findings import ReportError, find

    try:
        return find(recording)
    except ReportError as error:
        end(USAGE, str(error))


def _write(page: pathlib.Path, found: Findings, article: str, test: str) -> None:
    from rigctl.report.page import render

    with wrong_usage(output_file.OutputError):
        output_file.replace(page, render(found, article, test))


def _same(one: pathlib.Path, other: pathlib.Path) -> bool:
    return one.exists() and one.samefile(other)


def _say(found: Findings) -> None:
    for row in found.verdict.criteria:
        mark = "not judged" if row.met is None else "met" if row.met else "NOT MET"
        say(f"{row.name:38} {row.found:>18}  {row.limit:>8}  {mark}")
    for one in found.culprits:
        say(f"culprit at {found.utc(one.t_ns)}: {one.culprit.words}")
    for remark in found.remarks:
        say(f"note: {remark}")
    say(found.verdict.word)


def _complaint(found: Findings) -> str:
    missed = [row.name for row in found.verdict.criteria if row.met is False]
    return "not met: " + ", ".join(missed) if missed else "no compensating phase in it: nothing to judge"
