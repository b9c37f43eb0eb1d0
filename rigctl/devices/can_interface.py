"""The python-can interface of a rig file: what it lacks on this computer, and its bus.

A backend may raise anything where its vendor's module, its driver or an option is missing, and may write the cause to
its log alone. Here each becomes one line.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import logging
from collections.abc import Iterator
from typing import Any

import can
from can import interfaces, util

from rigctl.config.can_section import CanSettings
from rigctl.config.one_line import on_one_line

_LOGS = tuple(map(logging.getLogger, ("can", "seeedbus")))  # the second of a backend that keeps its own
for _log in _LOGS:
    _log.addHandler(logging.NullHandler())  # without one, what it logs goes to standard error
_OF_A_LOST_OBJECT = "was not properly shut down"  # of a bus that could not be opened


class OpenError(RuntimeError):
    """The bus cannot be opened; ``str()`` is one line, without interface and channel."""


class _Heard(logging.Handler):
    """Keeps what is logged."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line."""
        self.lines.append(record.getMessage())


@contextlib.contextmanager
def _errors_worded(settings: CanSettings) -> Iterator[None]:
    """A block of python-can of which any error becomes one line, with what was logged."""
    heard = _Heard()
    for log in _LOGS:
        log.addHandler(heard)
    try:
        yield
    except TypeError as error:
        raise OpenError(
            f"python-can's {settings.interface} lacks an option, or has one too many "
            f"({on_one_line(' '.join(str(error).split()))}): python-can reads them from ~/.canrc or /etc/can.conf"
        ) from None
    except Exception as error:  # noqa: BLE001 - each backend raises its vendor's own
        raise OpenError(_words(error, settings, heard.lines)) from None
    finally:
        for log in _LOGS:
            log.removeHandler(heard)


def _words(error: Exception, settings: CanSettings, logged: list[str]) -> str:
    """What a backend says, without the name of interface and channel that some put before it."""
    numbered = error.strerror if isinstance(error, OSError) else None
    words = " ".join((numbered or str(error) or type(error).__name__).split())
    for name in (f"{settings.interface}:{settings.channel}", settings.channel):
        words = words.removeprefix(f"{name}: ")
    more = [" ".join(line.split()) for line in logged if _OF_A_LOST_OBJECT not in line]
    said = [line for line in dict.fromkeys(more) if line not in words]
    return on_one_line(f"{words} ({'; '.join(said)})" if said else words)


def opened(settings: CanSettings) -> can.BusABC:
    """The bus.

    Raises:
        OpenError: it cannot be opened.
    """
    with _errors_worded(settings):
        return can.Bus(**_options(settings))


def lacking(settings: CanSettings) -> str:
    """What the interface lacks on this computer, in words: a module, an option; "": nothing that shows unopened."""
    try:
        with _errors_worded(settings):
            options = dict(util.load_config(config=_options(settings)))
            module, name = interfaces.BACKENDS[options.pop("interface")]
            inspect.signature(getattr(importlib.import_module(module), name)).bind(options.pop("channel"), **options)
    except OpenError as error:
        return str(error)
    return ""


def _options(settings: CanSettings) -> dict[str, Any]:
    return {"interface": settings.interface, "channel": settings.channel, "bitrate": settings.bitrate_bit_s}
