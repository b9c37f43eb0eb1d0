"""The page's bar of commands, made of the catalogue: a button for each, and a field where it takes a number."""

from __future__ import annotations

from html import escape

from rigctl.model.verbs import Option, Verb, VerbTrait
from rigctl.wire.offers import BUTTONS

MARK = "<!-- commands -->"
"""Where the bar is in the page's HTML."""


def bar() -> str:
    """The buttons after HOLD, which is in the page itself."""
    return "\n    ".join(map(_button, BUTTONS))


def number_of(verb: Verb) -> Option | None:
    """The number that a command takes, where it has a button."""
    return next((option for option in verb.row.options if option.noun), None)


def _button(verb: Verb) -> str:
    name, number = verb.name.lower(), number_of(verb)
    away = "in-fault" if VerbTrait.IN_FAULT in verb.row.traits else ""
    classes = f' class="{away}"' if away and number is None else ""
    button = f'<button type="button"{classes} data-verb="{name}" aria-describedby="why-not">{verb.name}</button>'
    return button if number is None else f'<span class="{f"target {away}".rstrip()}">{_field(number)}{button}</span>'


def _field(number: Option) -> str:
    unit, mode = number.field.unit if number.field else "", number.shown_in
    place = f' data-only-in="{mode.name}"' if mode is not None else ""
    return (
        f'<span class="field"{place}><input id="{number.noun}" type="text" inputmode="decimal" maxlength="40" '
        f'autocomplete="off" aria-label="{escape(number.label)}" aria-describedby="{number.noun}-bounds" '
        f'placeholder="{unit}"><small id="{number.noun}-bounds"></small></span>'
    )
