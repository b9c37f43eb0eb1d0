"""``rigctl install`` and ``uninstall``: a rig as services of this computer."""

from __future__ import annotations

import os
import pathlib
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import BAD, USAGE, end, load_rig_file, say, wrong_usage

if TYPE_CHECKING:
    from rigctl.cli.install_target import Target
    from rigctl.config.settings import RigSettings

Dry = Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")]
Root = Annotated[
    pathlib.Path, typer.Option("--root", metavar="DIR", help="Another root than /: only files, no services.")
]
_ROOT = pathlib.Path("/")


def install(
    file: Annotated[pathlib.Path, typer.Argument(metavar="FILE", help="Rig file.", autocompletion=rig_files)],
    dry_run: Dry = False,
    root: Root = _ROOT,
    adapter: Annotated[
        str | None,
        typer.Option(metavar="SERIAL", help="CAN adapter, by serial number or path of udev, that gets can.channel."),
    ] = None,
    operator: Annotated[
        str | None, typer.Option(metavar="USER", help="User of this computer who may command its rigs from now on.")
    ] = None,
    viewer: Annotated[
        str | None, typer.Option(metavar="USER", help="User of this computer who may read them from now on.")
    ] = None,
    start: Annotated[bool, typer.Option("--start/--no-start", help="Start the services too.")] = True,
) -> None:
    """Install a rig as services: settings to /etc/rigctl, units, CAN interface; data are kept. Repeat it to upgrade."""
    settings = load_rig_file(file)
    from rigctl.cli import install_files as files
    from rigctl.cli.check import accepted, verdict
    from rigctl.cli.install_target import ServiceError, Target, deploy_folder, program
    from rigctl.ipc.writers import OPERATORS, VIEWERS

    if not accepted(settings):
        end(BAD, f"{file}: {verdict(settings)}")
    target = Target(root, say, dry_run=dry_run)
    with wrong_usage(files.InstallError):
        computer = files.host(program(target.is_live))
        wanted = files.settings_files(settings, file)
        own = files.of_rig(settings, computer, adapter)
        common = {} if target.has_package else files.common(deploy_folder(), computer.python)
        target.refuse_shared(settings.rig, wanted)
        loops = _loops(target, {settings.rig: settings.loop.cpu})
        cpus = files.processors(loops, computer)
    _check_rights(target)
    changed = sum([target.keep_and_write(wanted), target.write(own), target.write(common), target.write(cpus)])
    changed += target.drop_stale(settings.rig, own, cpus)
    if target.is_live:
        try:
            members = {OPERATORS: operator, VIEWERS: viewer}
            target.activate(settings.rig, files.units(settings), start=start, members=members)
        except ServiceError as error:
            end(BAD, str(error))
    _say_end(settings, target, changed, started=start)


def uninstall(
    rig: Annotated[str, typer.Argument(metavar="RIG", help="Name of the rig.")],
    dry_run: Dry = False,
    root: Root = _ROOT,
    leave_load: Annotated[
        bool, typer.Option("--leave-load", help="Also while the motor carries a load, which the end lowers or leaves.")
    ] = False,
) -> None:
    """Stop a rig's services and remove what install wrote; its settings and data stay."""
    from rigctl.cli import install_files as files
    from rigctl.cli.install_target import ServiceError, Target, deploy_folder, program

    target = Target(root, say, dry_run=dry_run)
    if rig not in target.rigs():
        end(USAGE, f"{rig}: found no rig of this name among the installed: {', '.join(target.rigs()) or 'none'}")
    if target.is_live and not leave_load:
        from rigctl.cli.carried_service import refusal

        if why := refusal(rig):
            end(BAD, why)
    _check_rights(target)
    if target.is_live:
        try:
            target.deactivate(rig)
        except ServiceError as error:
            end(BAD, str(error))
    with wrong_usage(files.InstallError):
        computer = files.host(program(live=False))
        cpus = files.processors(_loops(target, {rig: None}), computer)
    target.remove_rig(rig)
    target.write(cpus)
    target.drop_stale_processors(cpus)
    if not target.rigs(apart=rig) and not target.has_package:
        target.remove(files.common(deploy_folder(), computer.python))
    if target.is_live:
        target.reload()
    say(f"{rig}: uninstalled; settings stay in {target.at('etc/rigctl')}, data in {target.at('var/lib/rigctl')}")


def _loops(target: Target, changed: dict[str, int | None]) -> list[int]:
    """Processors of the loops of every installed rig, with ``changed`` in place of what is there."""
    found = {rig: target.loop_of(rig) for rig in target.rigs() if rig not in changed} | changed
    return [cpu for cpu in found.values() if cpu is not None]


def _check_rights(target: Target) -> None:
    if not target.dry_run and target.is_live and os.geteuid() != 0:
        end(BAD, "found another user, expected root, who may write units (sudo rigctl ...; or --dry-run)")


def _say_end(settings: RigSettings, target: Target, changed: int, *, started: bool) -> None:
    if target.dry_run:
        say(f"{settings.rig}: {changed} files would be written or removed; nothing was done")
        return
    what = "nothing has changed" if not changed else f"{changed} files written or removed"
    say(f"{settings.rig}: installed, {what}")
    if target.is_live and started:
        if changed and target.was_running:
            restart = f"systemctl restart rigctl@{settings.rig}"
            say(f"{settings.rig} runs as it was started; bring it to DISARMED, then: {restart}")
        say(f"next: rigctl status, rigctl arm; messages: journalctl -u rigctl@{settings.rig}")
