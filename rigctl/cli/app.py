"""The ``rigctl`` command: loads what the command given needs, and turns wrong usage into one line."""

from __future__ import annotations

import os
import signal
import sys

from rigctl.cli import descriptors
from rigctl.config.one_line import complaint
from rigctl.ipc import standard_output
from rigctl.ipc.termination import on_signals

_HELP = {"-h", "--help"}
_OPTIONS_WITH_VALUE = {"--key"}


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit: 0 done, 1 refused or no daemon, 2 wrong usage or an output that cannot be written."""
    standard_output.guard()
    on_signals(signal.default_int_handler, signal.SIGTERM, signal.SIGHUP)  # end as by Ctrl-C
    if lacking := descriptors.shortage():
        sys.stderr.write(f"rigctl: {lacking}\n")
        raise SystemExit(1)
    code = _run(sys.argv[1:] if arguments is None else arguments)
    if unsaid := standard_output.complaint():
        sys.stderr.write(f"rigctl: {unsaid}\n")
        code = 2
    raise SystemExit(code)


def _run(words: list[str]) -> int | None:
    first, completing = first_word(words), "_RIGCTL_COMPLETE" in os.environ
    try:
        if first in _HELP and not completing:
            from rigctl.cli.top_help import top_help

            sys.stdout.write(top_help())
            return 0
        if first == "hold" and not completing:
            from rigctl.cli.quick_hold import hold_here

            if (code := hold_here(words)) is not None:
                return code
        from rigctl.cli import typer_app

        return typer_app.run(first, words)
    except KeyboardInterrupt:
        sys.stderr.write("rigctl: interrupted; the rig goes on by itself\n")
    except OSError as error:  # a full or read-only disk, no memory, no folder for temporary files
        where = f"{error.filename}: " if error.filename is not None else ""
        sys.stderr.write(complaint(f"rigctl: {where}{error.strerror or error}") + "\n")
    return 1


def first_word(words: list[str]) -> str:
    """The command, or a request for help or any other option before it; empty without either."""
    rest = iter(words)
    for word in rest:
        if word in _OPTIONS_WITH_VALUE:
            next(rest, None)
        elif word.partition("=")[0] not in _OPTIONS_WITH_VALUE:
            return word
    return ""


if __name__ == "__main__":
    main()
