"""The commands that take a rig file: ``run``, ``check``, ``demo``."""

from __future__ import annotations

import contextlib
import datetime
import pathlib
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.json_file import STANDARD_OUTPUT, JsonFile
from rigctl.cli.json_file import complaint as json_complaint
from rigctl.cli.options import BAD, DONE, USAGE, Json, check_output, end, load_rig_file, say, say_json, wrong_usage
from rigctl.ipc import output_file, standard_output

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings

DEMO_FILE = pathlib.Path("config/paper_rig.yaml")
DEMO_RECORDINGS = pathlib.Path("recordings")
File = Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Rig file.", autocompletion=rig_files)]


def _check_files(settings: RigSettings, *, keys: bool = True) -> None:
    """End the command on an invalid EDS file, gain file, ledger, audit log or key folder, before anything starts.

    ``keys``: check the key folder, which a gateway of another user alone can read.
    """
    from rigctl.ipc import ledger
    from rigctl.recorder import audit_log

    _check_eds(settings)
    if settings.page is not None and settings.page.tls_cert is not None and settings.page.tls_key is not None:
        from rigctl.page import certificate

        with wrong_usage(certificate.CertificateError):
            certificate.context(settings.file(settings.page.tls_cert), settings.file(settings.page.tls_key))
    with wrong_usage(ledger.LedgerError, audit_log.AuditError):
        ledger.read(settings)
        audit_log.check(settings.audit_log, settings.rig)
    if keys and settings.key_folder is not None:
        from rigctl.identity.key_folder import KeyFolder, KeyFolderError

        with wrong_usage(KeyFolderError):
            KeyFolder(settings.key_folder).check_gateway(datetime.datetime.now(datetime.UTC))


def _check_eds(settings: RigSettings) -> None:
    from rigctl.devices import eds_file

    with wrong_usage(eds_file.EdsError):
        eds_file.check(settings)


def _with_page(settings: RigSettings, page: bool | None, listen: str | None) -> RigSettings:
    """The settings, with a page if an option adds one, without one if an option leaves it to a unit of its own."""
    if page is False:
        return settings.model_copy(update={"page": None})
    if listen is not None:
        from rigctl.config.address import Address, AddressError
        from rigctl.config.page_section import PageSettings

        try:
            Address.parse(listen)
        except AddressError as error:
            end(USAGE, f"--page-listen: {error}")
        found = settings.page or PageSettings()
        return settings.model_copy(update={"page": found.model_copy(update={"listen": listen})})
    if page and settings.page is None:
        from rigctl.config.page_section import PageSettings

        return settings.model_copy(update={"page": PageSettings()})
    return settings


def _adopted(settings: RigSettings) -> RigSettings:
    """The settings with what their gain file replaces."""
    if settings.design.gains_file is None:
        return settings
    from rigctl.design import gain_file, in_use

    with wrong_usage(gain_file.GainFileError):
        return in_use.adopted(settings)


def _refuse_unseen(file: pathlib.Path, settings: RigSettings) -> None:
    """End the command where a frozen cell could move the load by more than a tenth unseen."""
    from rigctl.cli.probe_check import refusal

    with _designing(file):
        why = refusal(settings)
    if why is not None:
        end(USAGE, f"{file}: {why}; or safety.waiver: why not, in words")


@contextlib.contextmanager
def _designing(file: pathlib.Path) -> Iterator[None]:
    """A block that designs: without gains for the file the command ends with one line."""
    try:
        yield
    except (ArithmeticError, ValueError) as error:  # DesignError is one; the others: numbers that no plant has
        end(BAD, f"{file}: no design: {' '.join(str(error).split())}")


def check(file: File, json: Json = False) -> None:
    """Validate a rig file and its design; show the resolved rig and the worst-case load of its bus."""
    settings = load_rig_file(file)
    _check_eds(settings)
    used = _adopted(settings)
    from rich.console import Console

    from rigctl.cli import check as checking

    _refuse_unseen(file, used)
    with _designing(file):
        from rigctl.design.in_use import design_in_use

        design = design_in_use(used)
    lacking = _lacking(settings)
    from rigctl.ipc import ledger

    if doubt := ledger.clock_doubt(settings, design.as_dict(), datetime.datetime.now(datetime.UTC)):
        sys.stderr.write(f"WARNING: {doubt}\n")
    if json:
        found = checking.as_dict(settings)
        accepted = found["accepted"] and design.accepted and not lacking
        say_json({**found, "accepted": accepted, "design": design.as_dict()})
    else:
        checking.show(settings, Console())
        checking.show_design(design, Console())
    if not checking.accepted(settings):
        end(BAD, f"{file}: {checking.verdict(settings)}")
    if not design.accepted:
        end(BAD, f"{file}: {design.verdict()}")
    if lacking:
        end(BAD, f"{file}: can.interface: {settings.can.interface} cannot be opened on this computer: {lacking}")


def _lacking(settings: RigSettings) -> str:
    """What the interface of python-can lacks on this computer; nothing is opened."""
    from rigctl.config.can_section import OWN

    if settings.can.interface in OWN:
        return ""
    from rigctl.devices import can_interface

    return can_interface.lacking(settings.can)


def run(
    file: File,
    page: Annotated[
        bool | None, typer.Option("--page/--no-page", help="Serve the live page too, read-only; or not in any case.")
    ] = None,
    page_listen: Annotated[
        str | None, typer.Option("--page-listen", metavar="HOST:PORT", help="The same, there [127.0.0.1:8080].")
    ] = None,
    separate_users: Annotated[
        bool,
        typer.Option("--separate-users", help="Recorder and gateway are services of their own."),
    ] = False,
) -> None:
    """Run the daemon until SIGTERM, SIGHUP or Ctrl-C; it ends with the stroke held."""
    standard_output.never_wait()
    settings = _adopted(_with_page(load_rig_file(file), page, page_listen))
    from rigctl.cli.check import accepted, verdict
    from rigctl.supervisor.daemon import CannotRunError, Supervisor

    if not accepted(settings):
        end(BAD, f"{file}: {verdict(settings)}")
    _refuse_unseen(file, settings)
    _check_files(settings, keys=not separate_users)
    log = lambda text: say(f"{time.strftime('%H:%M:%S')} {text}")  # noqa: E731
    try:
        code = Supervisor(settings, log, separate_users=separate_users).run()
    except CannotRunError as error:
        end(BAD, str(error))
    raise typer.Exit(code)


def demo(
    file: File = DEMO_FILE,
    json: JsonFile = None,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Play in simulated time.")] = False,
    recordings: Annotated[
        pathlib.Path, typer.Option(metavar="FOLDER", help="Leave the recording here.")
    ] = DEMO_RECORDINGS,
) -> None:
    """Play the paper's move on the simulated rig and judge it by the rig file's own limits."""
    settings = load_rig_file(file)
    for section in ("demo", "simulation"):
        if getattr(settings, section) is None:
            end(USAGE, f"{file}: {section}: found nothing, expected a section (the demo needs it)")
    import msgspec
    from rich.console import Console

    from rigctl.cli.demo import run as play
    from rigctl.demo.script import DemoError

    assert settings.demo is not None
    if json is not None and json.resolve() == file.resolve():
        end(USAGE, f"--json: {json} is the rig file, expected a file of its own")
    if (why := json_complaint(json)) is not None:
        end(USAGE, why)
    prints = json == STANDARD_OUTPUT
    check_output("--json", None if prints else json)
    try:
        summary = play(settings, settings.demo, Console(stderr=prints), recordings.resolve(), lockstep=lockstep)
    except DemoError as error:
        end(BAD, f"demo: {error}")
    except KeyboardInterrupt:
        end(BAD, "demo interrupted: its daemon held the stroke, and its processes are ended")
    if json is not None:
        text = msgspec.json.format(msgspec.json.encode(summary.as_dict()), indent=2).decode()
        if prints:
            say(text)
        else:
            with wrong_usage(output_file.OutputError):
                output_file.write(json, text + "\n")
    raise typer.Exit(DONE if summary.passed else BAD)
