"""``python -m hil fmu``: the plant of a rig file as an FMU."""

from __future__ import annotations

import pathlib
import sys

from hil.fmu.fmu_file import FmuError, make
from rigctl.config import rig_file
from rigctl.ipc import output_file


def run(file: pathlib.Path, out: pathlib.Path) -> int:
    """Write the FMU; returns the exit code.

    Raises:
        OutputError: the file cannot be written.
    """
    output_file.check("--out", out)
    try:
        settings = rig_file.load(file)
        with output_file.writing(out):
            make(settings, out)
    except rig_file.ConfigError as error:
        sys.stderr.write("\n".join(error.findings) + "\n")
        return 2
    except FmuError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{out}: FMI 3.0 co-simulation of {settings.rig}, {out.stat().st_size / 1024:.0f} KiB\n")
    return 0
