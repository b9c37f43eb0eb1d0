"""``python -m hil``: the simulated rig's commands."""

from __future__ import annotations

import os
import pathlib
import signal
import sys
from enum import Enum
from typing import Annotated

from rigctl.config import extras
from rigctl.config.one_line import complaint, wrong_usage
from rigctl.ipc import output_file
from rigctl.ipc.termination import on_signals

PROGRAM = "python -m hil"
PAPER = "paper_rig.yaml"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: more threads are slower with matrices this small
with extras.refused(PROGRAM):
    import typer
    from typer.exceptions import TyperException

    from hil.scenario.errors import ScenarioError
    from hil.serve import ServeError, serve
    from rigctl.cli import descriptors, json_file
    from rigctl.cli.json_file import JsonFile
    from rigctl.cli.options import SEED, number_option
    from rigctl.config import rig_file
    from rigctl.config.typed_number import TypedNumber
    from rigctl.ipc import standard_output

_INTERRUPTED = 130
"""Exit code that typer gives Ctrl-C."""

_WHOLE, _COUNT = TypedNumber(whole=True), TypedNumber(least=0, whole=True)

PaperOr = Annotated[pathlib.Path | None, typer.Argument(help="rig file; if not given, the paper's, as it is shipped")]

app = typer.Typer(
    add_completion=False,  # a shell completes the name of a program, and this one is a module
    help="The simulated rig.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


@app.callback()
def _commands() -> None:
    """The simulated rig."""


@app.command("serve")
def _serve(
    file: Annotated[pathlib.Path, typer.Argument(help="rig file")],
    truth: Annotated[pathlib.Path | None, typer.Option(help="write the plant's true state here, 1 kHz")] = None,
) -> None:
    """Serve the rig of FILE on its CAN bus until interrupted."""
    standard_output.never_wait()
    from hil.faults.served import taking_faults
    from rigctl.cli.progress import progress

    serve(file, truth, _announce, taking_faults, lambda title: progress(title, None))


@app.command("scenario")
def _scenario(
    file: Annotated[pathlib.Path, typer.Argument(help="scenario file, see docs/scenario.md")],
    json: JsonFile = None,
    plot: Annotated[pathlib.Path | None, typer.Option(help="draw the run here: .png, .svg or .pdf")] = None,
) -> None:
    """Play the scenario of FILE through the real loop in simulated time, or with the cylinder locked."""
    from hil.cli.scenario import run

    raise typer.Exit(run(file, json, plot))


@app.command("paper")
def _paper(
    file: PaperOr = None,
    json: JsonFile = None,
    plots: Annotated[pathlib.Path | None, typer.Option(help="folder for a picture per figure")] = None,
) -> None:
    """Play the paper's study, locked and with the loop closed, and compare it with what the paper prints."""
    from hil.studies.cli.paper import run

    raise typer.Exit(run(file or rig_file.shipped(PAPER), json, plots))


@app.command("compare")
def _compare(
    file: PaperOr = None,
    only: Annotated[
        list[str] | None, typer.Option(help="a scenario to run, or a group; may be repeated; default all")
    ] = None,
    controllers: Annotated[
        list[str] | None, typer.Option(help="laws to run, separated by commas; may be repeated; default all")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="6 of the 18 scenarios: 2 minutes on 2 cores, not 9")] = False,
    json: JsonFile = None,
    plots: Annotated[pathlib.Path | None, typer.Option(help="folder for the pictures")] = None,
    bound: Annotated[
        bool, typer.Option("--bound", help="our law against the least error that any linear law reaches")
    ] = False,
    shares: Annotated[
        pathlib.Path | None,
        typer.Option(
            metavar="FILE", help="laws tuned under the same Ms and noise, by groups of scenarios over three seeds: JSON"
        ),
    ] = None,
    designs: Annotated[
        int | None,
        number_option(
            TypedNumber("designs", 1, whole=True),
            "--designs",
            metavar="N",
            help="of the studies of tuned laws: designs per parameter and start",
        ),
    ] = None,
    random: Annotated[
        int,
        number_option(
            TypedNumber("rigs", 0, whole=True),
            "--random",
            metavar="N",
            help="this many random rigs instead, identified and tuned for",
        ),
    ] = 0,
    seed: Annotated[int, number_option(SEED, "--seed", metavar="N", help="of the random rigs")] = 1,
    rows: Annotated[
        pathlib.Path | None, typer.Option(help="with the studies of tuned laws: keep each result here, and go on")
    ] = None,
    front: Annotated[pathlib.Path | None, typer.Option(help="draw error against Ms instead: png, svg, pdf")] = None,
) -> None:
    """Compare the tension law with its rivals: same plant, seed and limits, each tuned by its published rule.

    All of it takes about 17 minutes of processor time; --quick about 3. --shares takes about
    120, --random about 2 for each rig of ours (with --designs 5), --front about 10.
    """
    from hil.studies.cli import compare_tuned
    from hil.studies.cli.compare import run

    file = file or rig_file.shipped(PAPER)
    if random or bound or front is not None or shares is not None:
        asked = compare_tuned.Asked(only or [], controllers or [], json, rows, designs)
        if bound:
            raise typer.Exit(compare_tuned.run_bound(file, asked))
        if shares is not None:
            raise typer.Exit(compare_tuned.run_shares(file, shares, asked))
        if front is not None:
            raise typer.Exit(compare_tuned.run_front(file, front, asked))
        raise typer.Exit(compare_tuned.run_random(file, random, seed, asked))
    raise typer.Exit(run(file, only or [], controllers or [], json, plots, quick=quick))


@app.command("cell")
def _cell(
    file: PaperOr = None,
    cells: Annotated[
        int,
        number_option(
            TypedNumber("cells", 1, 10_000, whole=True), "--cells", metavar="N", help="number of cells drawn"
        ),
    ] = 200,
    json: JsonFile = None,
) -> None:
    """Hold the cell's stated uncertainty, before and after compensation, against the truth of many drawn cells."""
    from hil.studies.cli.cell import run

    raise typer.Exit(run(file or rig_file.shipped(PAPER), cells, json))


@app.command("moves")
def _moves(
    file: PaperOr = None,
    only: Annotated[list[str] | None, typer.Option(help="a variant to play; may be repeated; default all")] = None,
    json: JsonFile = None,
    plots: Annotated[pathlib.Path | None, typer.Option(help="folder for the picture")] = None,
) -> None:
    """Repeat one move with learning, and with what was tried against friction at the reversal (docs/reversal.md)."""
    from hil.studies.cli.moves import run

    raise typer.Exit(run(file or rig_file.shipped(PAPER), only or [], json, plots))


@app.command("roll-back")
def _roll_back(
    file: PaperOr = None,
    draw: Annotated[
        int,
        number_option(
            TypedNumber("errors", 1, 1000, whole=True),
            "--draw",
            metavar="N",
            help="errors of the preload drawn for each load",
        ),
    ] = 1,
    seed: Annotated[int, number_option(SEED, "--seed", metavar="N", help="of those errors")] = 1,
    json: JsonFile = None,
) -> None:
    """Let the motor take loads of 50 to 350 N from the brake, without a preload and with one of a drawn error."""
    from hil.studies.cli.roll_back import run

    raise typer.Exit(run(file or rig_file.shipped(PAPER), draw, seed, json))


@app.command("fmu")
def _fmu(
    file: Annotated[pathlib.Path, typer.Argument(help="rig file")],
    out: Annotated[pathlib.Path, typer.Option(help="write the FMU here")],
) -> None:
    """Write the plant as an FMU (FMI 3.0, co-simulation): compiled C, which needs no Python."""
    from hil.cli.fmu import run

    raise typer.Exit(run(file, out))


class NewKind(Enum):
    """What can be made."""

    RIG = "rig"


@app.command("new")
def _new(
    _kind: Annotated[NewKind, typer.Argument(metavar="rig", help="what to make")],
    name: Annotated[str, typer.Argument(help="of the rig: a to z, 0 to 9 and _, a letter first")],
    payload: Annotated[
        float | None, number_option(TypedNumber("kg"), "--payload", metavar="KG", help="suspended mass")
    ] = None,
    spring: Annotated[
        float | None,
        number_option(TypedNumber("N/mm"), "--spring", metavar="N_MM", help="stiffness of the series spring, N/mm"),
    ] = None,
    target: Annotated[
        float | None,
        number_option(
            TypedNumber("N"), "--target", metavar="N", help="vertical tension to hold; 10 N for each kg if not given"
        ),
    ] = None,
    speed: Annotated[
        float | None,
        number_option(TypedNumber("mm/s"), "--speed", metavar="MM_S", help="largest speed of the stroke, mm/s"),
    ] = None,
    stroke: Annotated[
        float | None,
        number_option(
            TypedNumber("mm"),
            "--stroke",
            metavar="MM",
            help="highest stroke commanded; what spring and target need if not given",
        ),
    ] = None,
    rate: Annotated[
        int | None, number_option(_WHOLE, "--rate", metavar="HZ", help="of the loop; the paper's rig has 1000")
    ] = None,
    bit_rate: Annotated[
        int | None, number_option(_WHOLE, "--bit-rate", metavar="BIT_S", help="of the bus; the paper's has 1000000")
    ] = None,
    cell_node: Annotated[
        int | None, number_option(_WHOLE, "--cell-node", metavar="ID", help="node of the tension amplifier; else 2")
    ] = None,
    inclinometer_node: Annotated[
        int | None, number_option(_WHOLE, "--inclinometer-node", metavar="ID", help="node of it; else 3")
    ] = None,
    drive_node: Annotated[
        int | None, number_option(_WHOLE, "--drive-node", metavar="ID", help="node of the cylinder's drive; else 4")
    ] = None,
    out: Annotated[pathlib.Path | None, typer.Option(metavar="FOLDER", help="write here; else to ./NAME")] = None,
    defaults: Annotated[bool, typer.Option("--defaults", help="ask nothing on a terminal")] = False,
) -> None:
    """Make a rig file, FOLDER/NAME.yaml, with EDS files and JSON Schemas beside it; nothing is overwritten.

    On a terminal it asks for each number that no option gives. Otherwise, and for what is not asked, the paper's rig.
    """
    from hil.cli.new import run
    from hil.new import rig_decisions as decisions

    given = {
        decisions.PAYLOAD: payload, decisions.SPRING: spring, decisions.TARGET: target, decisions.SPEED: speed,
        decisions.STROKE: stroke,
    }  # fmt: skip
    bus = {
        "loop.rate_hz": rate, "can.bitrate_bit_s": bit_rate, "tension_cell.node": cell_node,
        "inclinometer.node": inclinometer_node, "cylinder.node": drive_node,
    }  # fmt: skip
    raise typer.Exit(run(name, given, out, bus=bus, defaults=defaults))


@app.command("faults")
def _faults(
    file: PaperOr = None,
    only: Annotated[list[str] | None, typer.Option(help="a fault to play; may be repeated; default all")] = None,
    mode: Annotated[
        list[str] | None,
        typer.Option(help="a mode, also HOLD_PARKED, FAULT_PARKED; repeatable; default all"),
    ] = None,
    json: JsonFile = None,
    list_: Annotated[bool, typer.Option("--list", help="print the catalogue, play nothing")] = False,
    kills: Annotated[
        int,
        number_option(_COUNT, "--kills", metavar="N", help="kill or stop processes of the daemon this often instead"),
    ] = 0,
    gateway_kills: Annotated[
        int, number_option(_COUNT, "--gateway-kills", metavar="N", help="kill the gateway this often instead")
    ] = 0,
    draw: Annotated[int, number_option(_COUNT, "--draw", metavar="N", help="play N drawn pairs of faults instead")] = 0,
    seed: Annotated[
        int, number_option(_WHOLE, "--seed", metavar="N", help="of the draws; --only K plays draw K alone")
    ] = 1,
    rows: Annotated[
        pathlib.Path | None, typer.Option(help="keep draws here, go on with those of a stopped run")
    ] = None,
    replay: Annotated[pathlib.Path | None, typer.Option(help="play the draw of this file instead")] = None,
    diagnosis: Annotated[
        pathlib.Path | None,
        typer.Option(metavar="FOLDER", help="name each row's culprit; windows of played rows are kept here"),
    ] = None,
    hash_: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--hash", help="digests of what a set of runs does, into this file; goes on with one of a stopped run"
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="with --hash: every row in simulated time and 200 draws, in an hour")
    ] = False,
    texts: Annotated[
        pathlib.Path | None, typer.Option(help="every text of the program, into this file, instead")
    ] = None,
    against: Annotated[
        pathlib.Path | None, typer.Option(help="of another commit: what differs from its --hash or --texts")
    ] = None,
    ways_out: Annotated[
        pathlib.Path | None,
        typer.Option(
            metavar="FILE", help="take the steps displayed at each distinct end; keep them here, go on after a stop"
        ),
    ] = None,
) -> None:
    """Play the fault catalogue: every fault in every mode, what happens against what has to happen."""
    from hil.cli import draw as draws
    from hil.cli import faults as command

    file = file or rig_file.shipped(PAPER)
    if hash_ is not None or texts is not None or every or against is not None:
        raise typer.Exit(_compared(file, hash_, texts, against, every=every))
    if ways_out is not None:
        from hil.cli.faults_ways_out import run as lead_out

        raise typer.Exit(lead_out(file, ways_out, only or [], mode or []))
    if replay is not None:
        raise typer.Exit(draws.replay(file, replay, json))
    if diagnosis is not None and draw:
        raise typer.Exit(draws.run_named(file, draw, seed, json))
    if diagnosis is not None:
        raise typer.Exit(command.run_diagnosis(file, diagnosis, only or [], mode or [], json))
    if draw:
        raise typer.Exit(draws.run(file, draw, seed, only or [], json, rows))
    if list_:
        command.show_list()
    elif kills:
        raise typer.Exit(command.run_kills(file, kills, json))
    elif gateway_kills:
        raise typer.Exit(command.run_kills(file, gateway_kills, json, gateway=True))
    else:
        raise typer.Exit(command.run(file, only or [], mode or [], json))


def _compared(
    file: pathlib.Path, hash_: pathlib.Path | None, texts: pathlib.Path | None, against: pathlib.Path | None, *,
    every: bool,
) -> int:  # fmt: skip
    """What this commit does or has in words, for the comparison with another."""
    if hash_ is not None and texts is not None:
        raise ScenarioError(["--texts: found --hash too, expected one of them"])
    if every and hash_ is None:
        raise ScenarioError(["--all: found no --hash, expected it with the file that gets the digests"])
    if hash_ is not None:
        from hil.cli.faults_hash import run

        return run(file, hash_, against, every=every)
    if texts is not None:
        from hil.cli import faults_texts

        return faults_texts.run(file, texts, against, app, PROGRAM)
    raise ScenarioError(["--against: found neither --hash nor --texts, expected one with the file to compare"])


@app.command("inject")
def _inject(
    file: Annotated[pathlib.Path | None, typer.Argument(help="rig file, whose simulated rig is served")] = None,
    fault: Annotated[str | None, typer.Argument(help="id of the fault")] = None,
    for_: Annotated[
        float | None, number_option(TypedNumber("seconds"), "--for", metavar="S", help="seconds; else until --end")
    ] = None,
    end: Annotated[bool, typer.Option("--end", help="end the fault that is active")] = False,
    list_: Annotated[bool, typer.Option("--list", help="print the faults that can be put into a running rig")] = False,
    for_this_rig: Annotated[
        bool, typer.Option("--for-this-rig", help="with RIG --list: those that the devices of the rig file can have")
    ] = False,
) -> None:
    """Put a fault of the catalogue into the simulated rig that runs (python -m hil serve), for a while or until --end.

    At its end the wire, the readings and the mechanics are as before; what has happened meanwhile stays.
    """
    from hil.cli import inject as command

    if list_:
        raise typer.Exit(command.show_list(file, for_this_rig=for_this_rig))
    raise typer.Exit(command.run(file, fault, for_, end=end))


def _announce(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    """Run a command; each refusal is one line on stderr. Exit code 0 good, 1 bad result or no bus, 2 usage or files."""
    standard_output.guard()
    on_signals(signal.default_int_handler, signal.SIGTERM, signal.SIGHUP)  # ends the child processes as Ctrl-C does
    if lacking := descriptors.shortage():
        sys.stderr.write(f"hil: {lacking}\n")
        return 1
    with extras.refused(PROGRAM):
        code = _run()
    if unsaid := standard_output.complaint():
        sys.stderr.write(f"hil: {unsaid}\n")
        return 2
    return code


def _run() -> int:
    try:
        code = int(app(args=json_file.with_files(sys.argv[1:]), standalone_mode=False) or 0)
        if code == _INTERRUPTED:
            raise KeyboardInterrupt
        return code
    except (ServeError, ScenarioError) as error:
        sys.stderr.write(complaint(f"{error}") + "\n")
        return error.exit_code
    except (output_file.OutputError, rig_file.ConfigError) as error:
        sys.stderr.write(complaint(f"{error}") + "\n")
        return 2
    except TyperException as error:
        text = wrong_usage(error.format_message())  # names the option, unlike str()
        context = getattr(error, "ctx", None)
        command = context.info_name if context is not None and context.parent is not None else ""
        own = " ".join(filter(None, (PROGRAM, command)))
        sys.stderr.write(f"{complaint(f'hil: {text}')} (see {own} --help)\n")
        return 2
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write("hil: interrupted\n")
        return 1
    except OSError as error:  # a full or read-only disk, no memory, no temporary folder
        where = f"{error.filename}: " if error.filename is not None else ""
        sys.stderr.write(complaint(f"hil: {where}{error.strerror or error}") + "\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
