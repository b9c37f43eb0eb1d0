"""Files a command writes: refused before the work is done that would fill them."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
from collections.abc import Iterator


class OutputError(ValueError):
    """A file that cannot be written; ``str()`` is one line that names it."""

    def __init__(self, file: pathlib.Path, error: OSError, option: str = "") -> None:
        missing = isinstance(error, FileNotFoundError) and not file.parent.is_dir()
        reason = f"there is no folder {file.parent}" if missing else error.strerror or str(error)
        super().__init__(f"{option}: {file} cannot be written: {reason}".removeprefix(": "))


def check(option: str, file: pathlib.Path) -> None:
    """Try whether ``file`` could be written, and leave everything as it was.

    Raises:
        OutputError: it could not.
    """
    try:
        if file.exists() and not file.is_file() and not file.is_dir():
            if not os.access(file, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return  # a pipe that is opened and closed has told its reader that this was all
        new = not file.exists()
        file.open("ab").close()
        if new:
            file.resolve().unlink()  # of a link the file it names, not the link
    except OSError as error:
        raise OutputError(file, error, option) from None


def write(file: pathlib.Path, text: str) -> None:
    """Write a text.

    Raises:
        OutputError: it cannot be written.
    """
    with writing(file):
        file.write_text(text, encoding="utf-8")


def replace(file: pathlib.Path, text: str) -> None:
    """Write a text at once or not at all: who reads meanwhile finds the old one, whole.

    Raises:
        OutputError: it cannot be written; what was there stays.
    """
    with writing(file):
        place = file.resolve()  # of a link the file it names, not the link
        if place.exists() and not place.is_file():
            file.write_text(text, encoding="utf-8")  # a pipe, a device
            return
        part = place.with_name(f".{place.name}.{os.getpid()}.part")
        try:
            part.write_text(text, encoding="utf-8")
            if place.exists():
                part.chmod(place.stat().st_mode & 0o777)
            part.replace(place)
        finally:
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def writing(file: pathlib.Path) -> Iterator[None]:
    """A block that writes ``file``.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(file, error) from None
