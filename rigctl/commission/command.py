"""``rigctl tare``, ``calibrate``, ``identify``: one line each says what was found, or why nothing was."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer

from rigctl.operator.options import (
    BAD,
    DONE,
    USAGE,
    Connect,
    Json,
    Operator,
    Rig,
    daemon,
    end,
    operator_name,
    say,
    say_json,
)
from rigctl.operator.verbs import newtons_of

WeightN = Annotated[
    float | None,
    typer.Option("--weight-n", metavar="NEWTONS", parser=newtons_of, help="Known weight [calibration.reference_n]."),
]
Shunt = Annotated[bool, typer.Option("--shunt", help="Compare with the shunt [calibration.shunt_n].")]
Adopt = Annotated[bool, typer.Option("--adopt", help="Set the scale that makes them agree, within 2 %.")]

PLACES = ("hold", "tension")
Where = Annotated[
    str, typer.Option("--in", metavar="hold|tension", help="As the rope is in HOLD, or only if it is tight.")
]
OutFile = Annotated[pathlib.Path | None, typer.Option("--file", metavar="FILE", help="Write the entry here too.")]


def tare(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Make the unloaded cell read zero; within calibration.tare_limit_n, and on record."""
    _end(_give("tare", connect, rig, operator), json)


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
        end(USAGE, "found --shunt with --adopt or --weight-n, allowed --shunt alone")
    _end(_give("calibrate", connect, rig, operator, weight_n, shunt=shunt, adopt=adopt), json)


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
        end(USAGE, f"--in: found {where!r}, allowed {' or '.join(PLACES)}")
    if file is not None and (file.is_dir() or not file.parent.is_dir()):
        end(USAGE, f"--file: {file}: allowed a file in a folder that is there")
    answer = _give("identify", connect, rig, operator, tight=where == "tension")
    if file is not None and answer.get("accepted"):
        import msgspec

        file.write_bytes(msgspec.json.format(msgspec.json.encode(answer["entry"]), indent=2) + b"\n")
    if answer.get("accepted") and not json:
        _show(answer["entry"]["figures"]["rows"])
    _end(answer, json)


def _show(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    from rigctl.commission.proposal import rounded

    table = Table("", "in the file", "found", "+-", "", box=None)
    for row in rows:
        before = "-" if row["before"] is None else f"{row['before']:.4g}"
        found = ("-", "-") if row["found"] is None else rounded(row["found"], row["error"] or 0.0)
        table.add_row(row["key"], before, *found, row["unit"])
    Console(highlight=False).print(table)
    say("nothing was changed: what is to be believed goes into the rig file by hand")


def _give(
    verb: str,
    connect: str | None,
    rig: str | None,
    operator: str | None,
    value: float | None = None,
    **options: bool,
) -> dict[str, Any]:
    with daemon(connect, rig) as client:
        return client.command(verb, operator_name(operator), value, **options)


def _end(answer: dict[str, Any], json: bool) -> None:
    accepted = bool(answer.get("accepted"))
    if json:
        say_json(answer)
    elif accepted:
        say(str(answer["text"]))
    end(DONE if accepted else BAD, None if accepted or json else str(answer.get("text", answer)))
