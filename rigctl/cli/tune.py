"""``rigctl tune FILE``: gains from the plant in a rig file or as identified, with their margins over its family."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.json_file import STANDARD_OUTPUT, JsonFile
from rigctl.cli.json_file import complaint as json_complaint
from rigctl.cli.options import (
    BAD,
    DONE,
    SEED,
    USAGE,
    check_output,
    end,
    load_rig_file,
    number_option,
    say,
    wrong_usage,
)
from rigctl.config.typed_number import TypedNumber
from rigctl.ipc import output_file, wall_clock

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings
    from rigctl.design.search import Found
    from rigctl.design.tuning import Tuned
    from rigctl.ipc.ledger import Entry

SUFFIXES = (".png", ".svg", ".pdf")


def tune(
    file: Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Rig file.", autocompletion=rig_files)],
    json: JsonFile = None,
    plot: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="Draw Bode, Nyquist and sensitivity: png, svg, pdf.")
    ] = None,
    gains: Annotated[
        pathlib.Path | None, typer.Option(metavar="FILE", help="Write a gain file, for design.gains_file.")
    ] = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="Look for weights that meet design.ms_max, up to half a minute.")
    ] = False,
    from_: Annotated[
        pathlib.Path | None,
        typer.Option("--from", metavar="LEDGER", help="For the plant as identified, over the family about it."),
    ] = None,
    every_spring: Annotated[
        bool, typer.Option("--every-spring", help="With --from: for each spring that is identified.")
    ] = False,
    table: Annotated[
        bool, typer.Option("--table", help="With --from: gains for each tension and stroke that is identified.")
    ] = False,
    optimize: Annotated[
        bool, typer.Option("--optimize", help="Find the weights of least error within the limits, some minutes.")
    ] = False,
    seed: Annotated[int, number_option(SEED, "--seed", metavar="N", help="With --optimize: of the search.")] = 1,
    evaluations: Annotated[
        int,
        number_option(
            TypedNumber("designs", 50, 100_000, whole=True),
            "--evaluations",
            metavar="N",
            help="With --optimize: designs tried.",
        ),
    ] = 600,
) -> None:
    """Compute gains for a rig; show and judge their margins over the family of plants.

    The plant is that of the rig file, judged over the assumed family; with --from the identified one, over its own.
    """
    if (why := json_complaint(json)) is not None:
        end(USAGE, why)
    settings = load_rig_file(file, study=True)
    _check_outputs(file, {"--json": None if json == STANDARD_OUTPUT else json, "--plot": plot, "--gains": gains})
    if auto and (optimize or from_ is not None):
        end(USAGE, "--auto: expected without --from and --optimize, which looks for weights too")
    if every_spring and (from_ is None or gains is None):
        end(USAGE, "--every-spring: expected with --from and --gains")
    if table and from_ is None:
        end(USAGE, "--table: expected with --from")
    entries = _ledger(settings, from_)
    if auto:
        searched, tuned, others = *_searched(file, settings), []
    else:
        rigs = [settings]
        if every_spring and entries is not None:
            from rigctl.design.tuning import other_springs

            rigs += other_springs(settings, entries, datetime.now(UTC))
        searched = None
        tuned, *others = _tuned(file, rigs, entries, (seed, evaluations) if optimize else None, table=table)
    advice = _advice(tuned, searched) | _optimised(tuned, seed)
    _write(file, tuned, others, advice, json, plot, gains)
    if json != STANDARD_OUTPUT:
        _say(file, tuned, others, advice, gains)
        for written in (json, plot, gains):
            if written is not None:
                say(f"written: {written}")
        _say_notes(settings, gains)
    every = [each for spring in (tuned, *others) for each in (spring, *spring.points)]
    refused = next((each for each in every if not each.design.accepted), None)
    end(DONE if refused is None else BAD, None if refused is None else f"{file}: {refused.design.verdict()}")


def _say(
    file: pathlib.Path, tuned: Tuned, others: list[Tuned], advice: dict[str, Any], gains: pathlib.Path | None
) -> None:
    from rigctl.design import design_text

    for line in design_text.lines(tuned.settings, tuned.design):
        say(line)
    for line in design_text.origin(tuned):
        say(line)
    for line in _advice_lines(advice, file, written=gains is not None):
        say(line)
    for line in _table_lines(tuned):
        say(line)
    for other in others:
        say(f"spring {other.given.plant.spring_n_mm or 0.0:g} N/mm: {other.design.verdict()}")


def _table_lines(tuned: Tuned) -> Iterator[str]:
    if not tuned.points or tuned.plant is None:
        return
    yield "gain table, by operating point:"
    yield "  tension N   stroke mm   k N/mm   K_T mm/s/N   K_v     K_I mm/s/N/s   Ms"
    for each in (tuned, *tuned.points):
        assert each.plant is not None  # entries of a table are identified
        stroke = "any" if each.plant.stroke_mm is None else f"{each.plant.stroke_mm:.1f}"
        k_tension, k_speed, k_integral = each.design.gains.in_order
        yield (
            f"  {each.plant.tension_n:>9.1f}   {stroke:>9}   {each.plant.stiffness_n_mm.value:>6.4g}   "
            f"{k_tension:>10.4g}   {k_speed:<5.3g}   {k_integral:>12.4g}   {each.design.ms_max:.3f}"
        )
    if tuned.dwell_s is not None:
        yield (
            f"  changes at least {tuned.dwell_s:.3g} s apart are stable with every plant of "
            "both families (dwell time); the loop keeps to that"
        )


def _say_notes(settings: RigSettings, gains: pathlib.Path | None) -> None:
    from rigctl.config.bounds import STUDY, findings

    if settings.safety.waiver == STUDY:
        for key, value, allowed in findings(settings):
            say(f"note: `rigctl run` refuses this file: {key}: found {value}, expected {allowed}")
    kept = settings.design.gains_file
    if kept is not None and (gains is None or gains.resolve() != settings.file(kept).resolve()):
        say(f"note: `rigctl run` takes the gains of {settings.file(kept)}, not these")


def _ledger(settings: RigSettings, file: pathlib.Path | None) -> list[Entry] | None:
    """The entries of the ledger that was named."""
    if file is None:
        return None
    from rigctl.ipc import ledger

    if not file.is_file():
        end(USAGE, f"--from: {file} is no file, expected the rig's ledger ({settings.ledger})")
    own = settings.ledger is not None and file.resolve() == settings.ledger.resolve()
    with wrong_usage(ledger.LedgerError):
        return ledger.read(settings, None if own else file)


def _tuned(
    file: pathlib.Path,
    rigs: list[RigSettings],
    entries: list[Entry] | None,
    search: tuple[int, int] | None,
    *,
    table: bool,
) -> list[Tuned]:
    """A design for each of the settings; ``search``: seed and number of evaluations of the search for weights."""
    from rigctl.cli.progress import progress
    from rigctl.design.identified import NotIdentifiedError
    from rigctl.design.transitions import TransitionError
    from rigctl.design.tuning import Optimisation, tune

    found = []
    with progress("weights", len(rigs) * search[1] if search else 1.0) as advance:
        for settings in rigs:
            optimisation = Optimisation(*search, lambda: advance(1.0, "")) if search else None
            try:
                found.append(tune(settings, entries, optimisation, table=table))
            except NotIdentifiedError as error:
                end(USAGE, f"--from: {error}")
            except TransitionError as error:
                end(BAD, f"--table: {error}")
            except (ArithmeticError, ValueError) as error:  # no gains, or numbers no plant has
                end(USAGE, f"{file}: no design: {' '.join(str(error).split())}")
    return found


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


def _searched(file: pathlib.Path, settings: RigSettings) -> tuple[Found, Tuned]:
    from rigctl.design import plant_family, search
    from rigctl.design.tuning import Tuned

    try:
        found = search.auto(settings)
    except (ArithmeticError, ValueError) as error:  # no gains, or numbers no plant has
        end(USAGE, f"{file}: no design: {' '.join(str(error).split())}")
    return found, Tuned(found.settings, found.settings, plant_family.assumed(found.settings), found.design)


def _advice(tuned: Tuned, searched: Found | None) -> dict[str, Any]:
    """The result of the search, or the effect of each weight on a refused design."""
    from rigctl.design import search

    if searched is not None:
        weights = [asdict(weight) for weight in searched.weights]
        return {"auto": {"meets": searched.meets, "weights": weights, "against": list(searched.against)}}
    found = tuned.design
    if found.accepted or found.ms_max <= found.limit or tuned.plant is not None or tuned.best is not None:
        return {}
    return {"hints": [{**asdict(hint), "text": hint.in_words()} for hint in search.hints(tuned.settings)]}


def _optimised(tuned: Tuned, seed: int) -> dict[str, Any]:
    """The identified plant, the weights found by optimisation, and what the design replaces in the rig file."""
    from rigctl.design.knobs import at_bound

    said: dict[str, Any] = {}
    if tuned.plant is not None:
        said["identified"] = tuned.plant.as_dict()
    if (best := tuned.best) is not None:
        said["optimised"] = {
            "seed": seed, "evaluations": best.evaluations, "cost_ratio": best.ratio,
            "within": best.score.within, "rms_n": dict(best.score.rms_n),
            "at_bound": [knob.key for knob in at_bound(tuned.settings)],
        }  # fmt: skip
    if said:
        said["replaces"] = {key: {"file": was, "used": now} for key, (was, now) in tuned.replaces.items()}
    return said


def _optimised_lines(optimised: dict[str, Any] | None) -> Iterator[str]:
    if optimised is None:
        return
    if not optimised["within"]:
        yield "--optimize: no weights within every limit were found; the design above is the best of them"
    ratio = optimised["cost_ratio"]
    against = "" if ratio is None else f", largest error x {ratio:.2f} of that with the file's weights"
    yield f"--optimize: seed {optimised['seed']}, {optimised['evaluations']} designs{against}"
    for key in optimised["at_bound"]:
        yield f"--optimize: {key} is at the bound of its search"


def _advice_lines(advice: dict[str, Any], file: pathlib.Path, *, written: bool) -> Iterator[str]:
    yield from _optimised_lines(advice.get("optimised"))
    if advice.get("replaces") and not written:
        yield "to use this design: --gains FILE, and FILE as design.gains_file"
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
    tuned: Tuned,
    others: list[Tuned],
    advice: dict[str, Any],
    json: pathlib.Path | None,
    plot: pathlib.Path | None,
    gains: pathlib.Path | None,
) -> None:
    import msgspec

    from rigctl.design import gain_file
    from rigctl.ipc.seal import SealError

    settings, found = tuned.settings, tuned.design
    now = datetime.now(UTC)
    if why := wall_clock.unset(now):
        sys.stderr.write(f"WARNING: {why}: the gains are dated by it; set it\n")
    made = gain_file.provenance(settings, file, now)
    said = {"rig": settings.rig, **found.as_dict(), **advice, "provenance": made.model_dump()}
    text = msgspec.json.format(msgspec.json.encode(said), indent=2).decode()
    plain = tuned.plant is None and not tuned.replaces
    springs = [] if plain else [each.gains for each in (tuned, *others)]
    with wrong_usage(output_file.OutputError):
        if json is not None and json != STANDARD_OUTPUT:
            output_file.write(json, text + "\n")
        if plot is not None:
            from rigctl.design import margin_plot

            with output_file.writing(plot):
                margin_plot.draw(settings, found, plot, tuned.family)
        if gains is not None:
            with output_file.writing(gains):
                try:
                    gain_file.write(gains, found, made, settings, springs)
                except SealError as error:
                    sys.stderr.write(f"note: {gains} has no seal: {error}\n")
                    gain_file.write(gains, found, made, springs=springs)
    if json == STANDARD_OUTPUT:
        say(text)
