"""``rigctl tare``, ``calibrate``, ``identify``, ``gains``: each prints the result, or the reason without one."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer

from rigctl.cli.lease import give
from rigctl.cli.options import (
    BAD,
    USAGE,
    Connect,
    Json,
    Operator,
    Rig,
    daemon,
    end,
    end_with_answer,
    finite_number,
    operator_name,
    say,
)

WeightN = Annotated[
    float | None,
    typer.Option(
        "--weight-n", metavar="NEWTONS", parser=finite_number("newtons"), help="Known weight [calibration.reference_n]."
    ),
]
Shunt = Annotated[bool, typer.Option("--shunt", help="Compare with the shunt [calibration.shunt_n].")]
Adopt = Annotated[bool, typer.Option("--adopt", help="Set the scale that makes them agree, within 2 %.")]

PLACES = ("hold", "tension")
Where = Annotated[
    str, typer.Option("--in", metavar="hold|tension", help="As the rope is in HOLD, or only if it is tight.")
]
GainFileArgument = Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Gain file from `rigctl tune`.")]
OutFile = Annotated[pathlib.Path | None, typer.Option("--file", metavar="FILE", help="Write the entry here too.")]


def tare(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Make the unloaded cell read zero; within calibration.tare_limit_n, and on record."""
    end_with_answer(_give("tare", connect, rig, operator), json)


def calibrate(
    weight_n: WeightN = None,
    shunt: Shunt = False,
    adopt: Adopt = False,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Hold the cell against a known weight that hangs still, or against the shunt; on record, with a due date."""
    if shunt and (adopt or weight_n is not None):
        end(USAGE, "found --shunt with --adopt or --weight-n, expected --shunt alone")
    end_with_answer(_give("calibrate", connect, rig, operator, weight_n, shunt=shunt, adopt=adopt), json)


def identify(
    where: Where = "hold",
    file: OutFile = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Small steps of speed in HOLD tell lag, delay, stiffness, backlash and noise; proposes, and changes nothing."""
    if where not in PLACES:
        end(USAGE, f"--in: found {where!r}, expected {' or '.join(PLACES)}")
    if file is not None and (file.is_dir() or not file.parent.is_dir()):
        end(USAGE, f"--file: {file}: expected a file in a folder that is there")
    answer = _give("identify", connect, rig, operator, tight=where == "tension")
    if file is not None and answer.get("accepted"):
        import msgspec

        file.write_bytes(msgspec.json.format(msgspec.json.encode(answer["entry"]), indent=2) + b"\n")
    if answer.get("accepted") and not json:
        _show(answer["entry"]["figures"]["rows"])
    end_with_answer(answer, json)


def gains(
    file: GainFileArgument,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Act by the gains of a file from `rigctl tune --gains` from now on, in any mode, without a bump.

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
    from rich.table import Table

    from rigctl.commission.proposal import rounded

    table = Table("", "in the file", "found", "+- (95 %)", "", "", box=None)
    for row in rows:
        before = "-" if row["before"] is None else f"{row['before']:.4g}"
        found = ("-", "-") if row["found"] is None else rounded(row["found"], row["error"] or 0.0)
        table.add_row(row["key"], before, *found, row["unit"], row["why"])
    Console(highlight=False).print(table)
    say("nothing was changed: what is to be believed goes into the rig file by hand")


def _give(
    verb: str,
    connect: str | None,
    rig: str | None,
    operator: str | None,
    value: float | None = None,
    **options: bool | str,
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
