"""The ``rigctl`` command: registers the commands, and turns wrong usage into one line."""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated, cast

import typer

from rigctl import __version__
from rigctl.cli import (
    alarms,
    audit,
    bench,
    bridge,
    commission,
    descriptors,
    doctor,
    install,
    keys,
    lease,
    page,
    recordings,
    replay,
    report,
    standard_output,
    status,
    verbs,
    watch,
)
from rigctl.cli import run as daemon
from rigctl.cli import tune as design
from rigctl.ipc.termination import on_signals

app = typer.Typer(
    name="rigctl",
    help="Active suspension rig: run it, watch it, command it.",
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"rigctl {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and end.")
    ] = False,
    key: Annotated[
        str | None, typer.Option(metavar="FILE", help="Your key file, for an endpoint tls/HOST:PORT [RIGCTL_KEY].")
    ] = None,
) -> None:
    if key is not None:
        os.environ["RIGCTL_KEY"] = key  # for every client of this process and of those it starts


for command in (
    daemon.run, daemon.demo, daemon.check, design.tune, status.status, alarms.alarms, watch.watch, page.page,
    bridge.bridge, lease.lease,
    keys.keys, doctor.doctor, bench.bench, audit.audit, replay.replay, report.report,
    recordings.info, recordings.export,
    verbs.arm, verbs.tension, verbs.release, verbs.hold, verbs.disarm, verbs.reset, verbs.move,
    commission.tare, commission.calibrate, commission.identify, commission.gains,
    install.install, install.uninstall,
):  # fmt: skip
    app.command()(command)
# These take a negative number as a value, not as an option.
app.command(context_settings={"ignore_unknown_options": True})(verbs.target)
app.command(context_settings={"ignore_unknown_options": True})(verbs.confirm_stroke)

# click's class; where typer keeps its click depends on typer's version.
_UsageError = cast("type[typer.BadParameter]", typer.BadParameter.__bases__[0])


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit: 0 done, 1 refused or no daemon, 2 wrong usage or an output that cannot be written."""
    standard_output.guard()
    on_signals(signal.default_int_handler, signal.SIGTERM, signal.SIGHUP)  # end as by Ctrl-C
    if lacking := descriptors.shortage():
        sys.stderr.write(f"rigctl: {lacking}\n")
        raise SystemExit(1)
    try:
        code = app(args=arguments, standalone_mode=False)
    except _UsageError as error:
        text = " ".join(error.format_message().split()).rstrip(".")
        sys.stderr.write(f"rigctl: {text} (see rigctl --help)\n")
        code = 2
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write("rigctl: interrupted; the rig goes on by itself\n")
        code = 1
    except OSError as error:  # a full or read-only disk, no memory, no folder for temporary files
        where = f"{error.filename}: " if error.filename is not None else ""
        sys.stderr.write(f"rigctl: {where}{error.strerror or error}\n")
        code = 1
    if unsaid := standard_output.complaint():
        sys.stderr.write(f"rigctl: {unsaid}\n")
        code = 2
    raise SystemExit(code)


if __name__ == "__main__":
    main()
