"""Output files of commands, checked before the work whose result they take."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
from collections.abc import Iterator

from rigctl.ipc import whole_file


class OutputError(ValueError):
    """A file that cannot be written; ``str()`` is one line that names it."""

    def __init__(self, file: pathlib.Path, error: OSError, option: str = "") -> None:
        missing = isinstance(error, FileNotFoundError) and not file.parent.is_dir()
        reason = f"there is no folder {file.parent}" if missing else error.strerror or str(error)
        super().__init__(f"{option}: {file} cannot be written: {reason}".removeprefix(": "))


def check(option: str, file: pathlib.Path) -> None:
    """Check that ``file`` can be written, without a change.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        if file.exists() and not file.is_file() and not file.is_dir():
            if not os.access(file, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return  # opening and closing a pipe would end its reader's input
        new = not file.exists()
        file.open("ab").close()
        if new:
            file.resolve().unlink()  # the target of a link, not the link
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
    """Write a text whole or not at all; until then a reader finds the old file.

    Raises:
        OutputError: it cannot be written; the old file stays.
    """
    with writing(file):
        place = file.resolve()  # the target of a link, not the link
        if place.exists() and not place.is_file():
            file.write_text(text, encoding="utf-8")  # a pipe or a device cannot be replaced
            return
        part = place.with_name(f".{place.name}.{os.getpid()}.part")
        try:
            part.unlink(missing_ok=True)
            # A link that somebody put in its place beforehand is not followed.
            fd = os.open(part, whole_file.NEW, 0o666)
            with os.fdopen(fd, "w", encoding="utf-8") as written:
                written.write(text)
                if place.exists():
                    os.fchmod(fd, place.stat().st_mode & 0o777)
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
