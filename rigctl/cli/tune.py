"""``rigctl tune FILE``: gains from the plant in a rig file, with their margins over the family of plants."""

from __future__ import annotations

import os
import pathlib
import sys
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.options import BAD, DONE, USAGE, check_output, end, load_rig_file, say, wrong_usage
from rigctl.ipc import output_file

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings
    from rigctl.design.search import Found
    from rigctl.design.verdict import Design

STANDARD_OUTPUT = pathlib.Path("-")
SUFFIXES = (".png", ".svg", ".pdf")


def tune(
    file: Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Rig file.")],
    json: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="Write the figures here, - to print them instead.")
    ] = None,
    plot: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="Draw Bode, Nyquist and sensitivity: png, svg, pdf.")
    ] = None,
    gains: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="Write a gain file, for design.gains_file.")
    ] = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="Look for weights that meet design.ms_max, up to half a minute.")
    ] = False,
) -> None:
    """Compute gains from the plant in a rig file; show and judge their margins over the family of plants."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    settings = load_rig_file(file, study=True)
    _check_outputs(file, {"--json": None if json == STANDARD_OUTPUT else json, "--plot": plot, "--gains": gains})
    searched, found = _designed(file, settings, auto)
    settings = searched.settings if searched is not None else settings
    advice = _advice(settings, found, searched)
    _write(file, settings, found, advice, json, plot, gains)
    if json != STANDARD_OUTPUT:
        from rigctl.config.bounds import STUDY, findings
        from rigctl.design import design_text

        for line in design_text.lines(settings, found):
            say(line)
        for line in _advice_lines(advice, file):
            say(line)
        for written in (json, plot, gains):
            if written is not None:
                say(f"written: {written}")
        if settings.safety.waiver == STUDY:
            for key, value, allowed in findings(settings):
                say(f"note: `rigctl run` refuses this file: {key}: found {value}, expected {allowed}")
        kept = settings.design.gains_file
        if kept is not None and (gains is None or gains.resolve() != settings.file(kept).resolve()):
            say(f"note: `rigctl run` takes the gains of {settings.file(kept)}, not these")
    end(DONE if found.accepted else BAD, None if found.accepted else f"{file}: {found.verdict()}")


def _check_outputs(file: pathlib.Path, outputs: dict[str, pathlib.Path | None]) -> None:
    """Refuse outputs that cannot be written or would overwrite the rig file or one another, before the computation."""
    from rigctl.design import gain_file

    taken = {file.resolve(): "the rig file"}
    for option, path in outputs.items():
        if path is None:
            continue
        if path.resolve() in taken:
            end(USAGE, f"{option}: {path} is {taken[path.resolve()]}, expected a file of its own")
        taken[path.resolve()] = f"the file of {option}"
        if option == "--plot" and path.suffix.lower() not in SUFFIXES:
            end(USAGE, f"--plot: found {path}, expected a name ending in {', '.join(SUFFIXES)}")
        check_output(option, path)
        if option == "--gains" and path.exists():
            try:
                gain_file.read(path)
            except gain_file.GainFileError:
                end(USAGE, f"--gains: {path} is there and is no gain file, expected a new file or a gain file")


def _designed(file: pathlib.Path, settings: RigSettings, auto: bool) -> tuple[Found | None, Design]:
    from rigctl.design import search
    from rigctl.design.margins import design_and_check

    try:
        searched = search.auto(settings) if auto else None
        return searched, searched.design if searched is not None else design_and_check(settings)
    except (ArithmeticError, ValueError) as error:  # no gains, or numbers no plant has
        end(USAGE, f"{file}: no design: {' '.join(str(error).split())}")


def _advice(settings: RigSettings, found: Design, searched: Found | None) -> dict[str, Any]:
    """The result of the search, or the effect of each weight on a refused design."""
    from rigctl.design import search

    if searched is not None:
        weights = [asdict(weight) for weight in searched.weights]
        return {"auto": {"meets": searched.meets, "weights": weights, "against": list(searched.against)}}
    if found.accepted or found.ms_max <= found.limit:
        return {}
    return {"hints": [{**asdict(hint), "text": hint.in_words()} for hint in search.hints(settings)]}


def _advice_lines(advice: dict[str, Any], file: pathlib.Path) -> Iterator[str]:
    if hints := advice.get("hints"):
        yield "what each weight alone can do:"
        yield from (f"  {hint['text']}" for hint in hints)
        if not hints[0]["meets"]:
            yield "no weight alone meets the limit: rigctl tune --auto looks for several"
    if (auto := advice.get("auto")) is None:
        return
    if auto["meets"] and not auto["weights"]:
        yield "--auto: the weights in the file meet the limit, nothing is to be changed"
    elif auto["meets"]:
        yield f"--auto: these weights meet the limit; they are the design above. To use them, in {file}:"
        for section in dict.fromkeys(weight["key"].split(".")[0] for weight in auto["weights"]):
            yield f"  {section}:"
            for weight in auto["weights"]:
                if weight["key"].startswith(f"{section}."):
                    yield f"    {weight['key'].split('.')[1]}: {weight['value']:g}  # was {weight['before']:g}"
    else:
        yield "--auto: no weights that meet the limit were found; the design above is the best. What stands against it:"
        yield from (f"  {line}" for line in auto["against"])


def _write(
    file: pathlib.Path,
    settings: RigSettings,
    found: Design,
    advice: dict[str, Any],
    json: pathlib.Path | None,
    plot: pathlib.Path | None,
    gains: pathlib.Path | None,
) -> None:
    import msgspec

    from rigctl.design import gain_file
    from rigctl.ipc.seal import SealError

    made = gain_file.provenance(settings, file, datetime.now(UTC))
    said = {"rig": settings.rig, **found.as_dict(), **advice, "provenance": made.model_dump()}
    text = msgspec.json.format(msgspec.json.encode(said), indent=2).decode()
    with wrong_usage(output_file.OutputError):
        if json is not None and json != STANDARD_OUTPUT:
            output_file.write(json, text + "\n")
        if plot is not None:
            from rigctl.design import margin_plot

            with output_file.writing(plot):
                margin_plot.draw(settings, found, plot)
        if gains is not None:
            with output_file.writing(gains):
                try:
                    gain_file.write(gains, found, made, settings)
                except SealError as error:
                    sys.stderr.write(f"note: {gains} has no seal: {error}\n")
                    gain_file.write(gains, found, made)
    if json == STANDARD_OUTPUT:
        say(text)
