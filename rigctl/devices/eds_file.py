"""EDS files (CiA 306), checked before any process starts, so that a bad file is reported as such."""

from __future__ import annotations

import logging

import canopen

from rigctl.config import input_file
from rigctl.config.one_line import printable
from rigctl.config.settings import RigSettings

LARGEST_BYTES = 4 << 20


class EdsError(ValueError):
    """A file that is no EDS file; ``str()`` is one line that names it."""


def check(settings: RigSettings) -> None:
    """Read the EDS file of every CANopen device.

    Raises:
        EdsError: the first file that cannot be read or parsed.
    """
    logging.getLogger("canopen.objectdictionary").setLevel(logging.ERROR)  # EdsError reports the same
    for device, node in settings.canopen_nodes.items():
        path = settings.file(getattr(settings, device).eds)
        try:
            input_file.read(path, largest=LARGEST_BYTES, links=True)
            found = canopen.import_od(str(path), node)
        except OSError as error:
            raise EdsError(f"{path}: cannot be read: {error.strerror}") from None
        except Exception as error:  # noqa: BLE001 - canopen's parser passes on all exceptions of its libraries
            what = printable(" ".join(f"{type(error).__name__}: {error}".split()))[:300]
            raise EdsError(f"{path}: no EDS file ({what}), expected one as in CiA 306") from None
        if not len(found):
            raise EdsError(f"{path}: found no objects, expected an EDS file as in CiA 306")
