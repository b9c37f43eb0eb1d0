"""``rigctl hold`` on the daemon's computer: the shortest way from a terminal to the loop.

It reads its few words itself, because typer alone takes longer to load than the rest of the way, and loads
neither Zenoh nor numpy nor msgspec. What it does not answer is left to `rigctl.cli.hold`: help, wrong usage, a daemon
elsewhere.
"""

from __future__ import annotations

import os
import sys
from typing import NamedTuple


class HoldWords(NamedTuple):
    """The options of ``rigctl hold``."""

    json: bool = False
    connect: str | None = None
    rig: str | None = None
    operator: str | None = None
    key: str | None = None


_WITH_VALUE = {"--connect": "connect", "--rig": "rig", "--operator": "operator"}


def read_words(words: list[str]) -> HoldWords | None:
    """The options in ``[--key FILE] hold ...``; None for a request for help and for what is no valid usage."""
    values: dict[str, str] = {}
    json, rest, options = False, iter(words), {"--key": "key"}
    for word in rest:
        name, equals, value = word.partition("=")
        if name in options:
            value = value if equals else next(rest, "")
            if not value.strip():
                return None
            values[options[name]] = value
        elif word == "hold" and options is not _WITH_VALUE:
            options = _WITH_VALUE
        elif word == "--json" and options is _WITH_VALUE:
            json = True
        elif word == "--" and options is _WITH_VALUE:
            if any(True for _ in rest):
                return None
        else:
            return None
    return HoldWords(json, **values)


def hold_here(words: list[str]) -> int | None:
    """Give HOLD on the local socket and print the answer; returns the exit code, None if it has to go elsewhere."""
    if (given := read_words(words)) is None:
        return None
    from rigctl.cli.operator_name import operator_name
    from rigctl.client import local_hold
    from rigctl.client.endpoint import chosen_endpoint

    named = given.rig or os.environ.get("RIGCTL_RIG") or None
    answer = local_hold.hold(chosen_endpoint(given.connect), named, operator_name(given.operator))
    if answer is None:
        return None
    if given.json:
        import msgspec

        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
    elif answer["accepted"]:
        sys.stdout.write(f"{answer['text']}\n")
    else:
        sys.stderr.write(f"rigctl: {answer['text']}\n")
    return 0 if answer["accepted"] else 1
