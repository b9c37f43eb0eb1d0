"""``rigctl doctor``: the preflight and the state of the computer, without any effect on the rig."""

from __future__ import annotations

import pathlib
import shutil
import textwrap
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import BAD, DONE, USAGE, Connect, Json, Rig, end, load_rig_file, say, say_json

if TYPE_CHECKING:
    from rigctl.cli.doctor_host import DoctorFinding
    from rigctl.config.settings import RigSettings

File = Annotated[
    pathlib.Path | None,
    typer.Argument(metavar="[FILE]", help="Rig file [the running daemon's].", autocompletion=rig_files),
]
_WIDEST = 100
_INDENT = 9


def doctor(file: File = None, json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Run the preflight without arming, and look at the computer: ok, warning or fails, and what to do.

    Exit code 0 if nothing fails, 1 if something does.
    """
    from rigctl.cli.doctor_host import Severity

    settings = load_rig_file(file) if file is not None else None
    findings = examine(settings, connect, rig)
    if json:
        say_json([finding.as_dict() for finding in findings])
    else:
        width = min(shutil.get_terminal_size((80, 24)).columns, _WIDEST)
        for finding in findings:
            for line in lines(finding, width):
                say(line)
        say(summary(findings))
    end(BAD if any(finding.severity is Severity.FAILS for finding in findings) else DONE)


def examine(settings: RigSettings | None, connect: str | None, rig: str | None) -> list[DoctorFinding]:
    """Every finding; without a rig file the daemon's settings are used."""
    from rigctl.cli import doctor_can, doctor_daemon, doctor_host, doctor_keys
    from rigctl.ipc import ledger, wall_clock
    from rigctl.ipc.runtime_folder import BASE

    state, active, why = _ask(settings, connect, rig)
    own = settings if settings is not None else _settings_of(active)
    now, design = datetime.now(UTC), active.get("design") if active is not None else None
    doubt = ledger.clock_doubt(own, design, now) if own is not None else wall_clock.doubt(now, {})
    findings = doctor_host.host(own, doubt=doubt)
    findings.append(doctor_host.other_daemons(own, BASE))
    if own is not None:
        findings += doctor_can.link(own.can)
        findings += doctor_keys.reach(own, now)
    if active is not None and state is not None:
        return findings + doctor_daemon.running(state, active, settings)
    lacks = doctor_host.fails if connect is not None else doctor_host.warning
    part = "no preflight" if own is None else "only what needs no daemon of the preflight"
    findings.append(lacks("daemon", f"{why}; {part}", "one that answers", "rigctl run FILE"))
    return findings + (doctor_daemon.without(own) if own is not None else [])


def lines(finding: DoctorFinding, width: int) -> list[str]:
    """A finding as text, no line longer than ``width``."""
    mark = finding.severity.value
    text = f"{finding.name} - {finding.found}"
    if finding.wanted and mark != "ok":
        text += f" (wanted: {finding.wanted})"
    head = f"{mark if mark == 'ok' else mark.upper():<{_INDENT}}"
    pad = " " * _INDENT
    found = textwrap.wrap(text, width, initial_indent=head, subsequent_indent=pad, break_on_hyphens=False)
    if finding.fix:
        found += textwrap.wrap(
            finding.fix, width, initial_indent=f"{pad}-> ", subsequent_indent=pad + "   ", break_on_hyphens=False
        )
    return found


def summary(findings: Sequence[DoctorFinding]) -> str:
    """Number of findings of each severity, in one line."""
    counted = {"ok": 0, "warning": 0, "fails": 0}
    for finding in findings:
        counted[finding.severity.value] += 1
    warnings = f"{counted['warning']} warning{'s' if counted['warning'] != 1 else ''}"
    return f"{counted['ok']} ok, {warnings}, {counted['fails']} failing"


def _ask(
    settings: RigSettings | None, connect: str | None, rig: str | None
) -> tuple[dict[str, Any] | None, dict[str, Any] | None, str]:
    """State and active configuration of the daemon, or why there are none."""
    from rigctl.client.connection import ChoiceError, Client, NoDaemonError, NoKeyError

    if settings is not None:
        connect, rig = connect or settings.telemetry.listen_here, rig or settings.rig
    try:
        with Client(connect, rig) as client:
            return client.state(), client.active(), ""
    except (NoDaemonError, NoKeyError) as error:
        return None, None, str(error)
    except ChoiceError as error:
        end(USAGE, str(error))


def _settings_of(active: dict[str, Any] | None) -> RigSettings | None:
    """The daemon's settings; None if another version wrote them and they are not valid here."""
    from pydantic import ValidationError

    from rigctl.config.settings import RigSettings

    try:
        return RigSettings.model_validate(active["settings"]) if active is not None else None
    except (ValidationError, KeyError):
        return None
