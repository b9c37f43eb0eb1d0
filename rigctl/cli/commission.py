"""``rigctl tare``, ``calibrate``, ``identify``, ``gains``: each prints the result, or the reason without one."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer

from rigctl.cli.lease import give
from rigctl.cli.operator_name import operator_name
from rigctl.cli.options import (
    BAD,
    USAGE,
    Connect,
    Json,
    Operator,
    Rig,
    check_output,
    daemon,
    end,
    end_with_answer,
    number_option,
    say,
)
from rigctl.config.typed_number import TypedNumber

WeightN = Annotated[
    float | None,
    number_option(
        TypedNumber("newtons"), "--weight-n", metavar="NEWTONS", help="Known weight [calibration.reference_n]."
    ),
]
Shunt = Annotated[bool, typer.Option("--shunt", help="Compare with the shunt [calibration.shunt_n].")]
Adopt = Annotated[
    bool, typer.Option("--adopt", help="Set the scale that makes them agree, within 2 %; or the creep found.")
]
Creep = Annotated[
    float | None,
    number_option(TypedNumber("minutes"), "--creep", metavar="MINUTES", help="Record the creep after the load's step."),
]

SUFFIXES = (".png", ".svg", ".pdf")
PLACES = ("hold", "tension")
MODES = ("hold", "compensating")
Where = Annotated[
    str | None,
    typer.Option(
        "--in", metavar="hold|tension|compensating",
        help="As the rope is in HOLD, or only if it is tight; --response: only in that mode [the one it is in].",
    ),
]  # fmt: skip
Response = Annotated[
    bool, typer.Option("--response", help="Frequency response by a multisine, a minute: plant, delay, resonance, Ms.")
]
Plot = Annotated[pathlib.Path | None, typer.Option("--plot", metavar="FILE", help="Draw the response: png, svg, pdf.")]
GainFileArgument = Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Gain file from `rigctl tune`.")]
OutFile = Annotated[pathlib.Path | None, typer.Option("--file", metavar="FILE", help="Write the entry here too.")]


def tare(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Make the unloaded cell read zero; within calibration.tare_limit_n, and on record."""
    end_with_answer(_give("tare", connect, rig, operator), json)


def calibrate(
    weight_n: WeightN = None,
    shunt: Shunt = False,
    adopt: Adopt = False,
    creep: Creep = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Hold the cell against a known weight that hangs still, or against the shunt; on record, with a due date.

    With --creep the cell's creep is recorded: within two minutes after the command the weight is hung on the unloaded
    cell (DISARMED), or taken off it; in HOLD on a tight rope the rope's relaxation is in the record too.
    """
    if shunt and (adopt or weight_n is not None or creep is not None):
        end(USAGE, "found --shunt with --adopt, --weight-n or --creep, expected --shunt alone")
    if creep is None:
        end_with_answer(_give("calibrate", connect, rig, operator, weight_n, shunt=shunt, adopt=adopt), json)
    from rigctl.control.excitation.trials import CREEP_LONGEST_S, CREEP_SHORTEST_S

    shortest, longest = CREEP_SHORTEST_S / 60.0, CREEP_LONGEST_S / 60.0
    if not shortest <= creep <= longest:
        end(USAGE, f"--creep: found {creep:g} minutes, expected {shortest:.2g} to {longest:g}")
    if not json:
        say(f"hang the weight on the cell within two minutes, then leave it alone for {creep:g} minutes")
    end_with_answer(_give("calibrate", connect, rig, operator, weight_n, adopt=adopt, creep_s=60.0 * creep), json)


def identify(
    where: Where = None,
    response: Response = False,
    file: OutFile = None,
    plot: Plot = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Small motions of the stroke tell lag, delay, stiffness and more; proposes, and changes nothing.

    Steps of speed in HOLD take 7 s. A multisine (--response), in HOLD or while COMPENSATING, takes a minute and gives
    the frequency response with the loop's margins.
    """
    places = MODES if response else PLACES
    if where is not None and where not in places:
        end(USAGE, f"--in: found {where!r}, expected {' or '.join(places)}")
    if plot is not None and not response:
        end(USAGE, "found --plot without --response, expected both")
    _check_files(file, plot)
    if response and not json:
        say("the stroke moves by a multisine for a minute; any command ends it")
    if response:
        answer = _give("response", connect, rig, operator, where=where or "")
    else:
        answer = _give("identify", connect, rig, operator, tight=where == "tension")
    if answer.get("accepted"):
        entry = answer["entry"]
        if file is not None:
            import msgspec

            file.write_bytes(msgspec.json.format(msgspec.json.encode(entry), indent=2) + b"\n")
        if plot is not None:
            from rigctl.commission import response_plot

            response_plot.draw(entry, plot)
        if not json:
            _show(_rows_of(entry) if response else entry["figures"]["rows"])
    end_with_answer(answer, json)


def _check_files(file: pathlib.Path | None, plot: pathlib.Path | None) -> None:
    """Refuse files that cannot be written before the rig is excited for nothing."""
    if file is not None and (file.is_dir() or not file.parent.is_dir()):
        end(USAGE, f"--file: {file}: expected a file in a folder that is there")
    if plot is None:
        return
    if plot.suffix.lower() not in SUFFIXES:
        end(USAGE, f"--plot: found {plot}, expected a name ending in {', '.join(SUFFIXES)}")
    if plot == file:
        end(USAGE, f"--plot: {plot} is the file of --file, expected a file of its own")
    check_output("--plot", plot)


def gains(
    file: GainFileArgument,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Act by the gains of a file from `rigctl tune --gains` from now on, in any mode, without a step.

    Only the design's weights may differ from the file that runs, and the margins are judged as at a start. They hold
    until the daemon ends; to keep them, name the file as design.gains_file in the rig file.
    """
    from rigctl.config import strict_yaml

    try:
        text = strict_yaml.text_of(file)
    except strict_yaml.FileError as error:
        end(USAGE, str(error))
    end_with_answer(_give("gains", connect, rig, operator, gain_file=text, name=file.name), json)


def _show(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Column, Table

    from rigctl.commission.proposal import rounded

    table = Table(Column(no_wrap=True), "in the file", "found", "+- (95 %)", "", "", box=None)  # a key is never cut
    for row in rows:
        before = "-" if row["before"] is None else f"{row['before']:.4g}"
        found = ("-", "-") if None in (row["found"], row["error"]) else rounded(row["found"], row["error"])
        table.add_row(row["key"], before, *found, row["unit"], row["why"])
    Console(highlight=False).print(table)
    say("nothing was changed: what is to be believed goes into the rig file by hand")


def _rows_of(entry: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of a frequency response, as `rigctl.commission.proposal` has them for an identification by steps."""
    figures, before = entry["figures"], entry["before"]
    labels = (
        ("stiffness", "stiffness_n_mm", "N/mm"), ("plant.cylinder_lag_s", "lag_s", "s"),
        ("plant.command_delay_s", "delay_s", "s"), ("delay of the cell", "sensor_delay_s", "s"),
        ("damping of the rope", "damping_n_s_mm", "N s/mm"), ("plant.mechanism_n_mm", "mechanism_n_mm", "N/mm"),
        ("damping ratio of the mechanism", "mechanism_damping", ""),
    )  # fmt: skip
    rows = []
    for key, name, unit in labels:
        pair = figures["plant"][name]
        above = pair.get("above")
        why = f"no resonance found: stiffer than {above:.0f} N/mm" if above is not None else ""
        if pair["error"] is None and pair["value"] is not None:
            why = "not separable from the delay of the cell"
        rows.append(_row(key, before.get(name), pair, unit, why))
    margins = figures["margins"]
    said = "measured" if margins["measured"] else "predicted for COMPENSATING"
    if margins["measured"] and margins.get("beyond"):
        said = f"predicted beyond {margins['covered_hz']:.2g} Hz; measured: at least {margins['at_least']:.3f}"
    rows.append(_row("Ms at the plant's input", None, margins["ms_input"], "", said))
    rows.append(_row("Ms at the tension", None, margins["ms_output"], "", said))
    return rows


def _row(key: str, before: float | None, pair: dict[str, Any], unit: str, why: str) -> dict[str, Any]:
    return {"key": key, "before": before, "found": pair["value"], "error": pair["error"], "unit": unit, "why": why}


def _give(
    verb: str,
    connect: str | None,
    rig: str | None,
    operator: str | None,
    value: float | None = None,
    **options: bool | str | float,
) -> dict[str, Any]:
    from concurrent.futures import ThreadPoolExecutor

    # Ctrl-C cannot interrupt Zenoh's wait for an answer, but it interrupts the wait for a thread.
    with daemon(connect, rig) as client, ThreadPoolExecutor(1) as pool:
        name = operator_name(operator)
        try:
            return pool.submit(give, client, verb, name, value, **options).result()
        except KeyboardInterrupt:
            client.command("hold", name)  # any command ends a trial; HOLD changes nothing else
            end(BAD, f"interrupted; {verb} was ended, the stroke is held")
