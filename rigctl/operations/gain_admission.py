"""Whether gains may replace those in force while the rig runs."""

from __future__ import annotations

from typing import Any

from rigctl.config.settings import RigSettings


class NotAdmittedError(ValueError):
    """The gains are refused; ``str()`` says why, in one line."""


def admitted(settings: RigSettings, text: str, name: str) -> dict[str, Any]:
    """The design of a gain file on a running rig, as in ``active.json``; ``name``: the file's, for messages.

    Raises:
        NotAdmittedError: it is not a gain file, not for this rig, or its margins are refused.
    """
    from rigctl.design.gains import DesignError
    from rigctl.design.in_use import design_while_running  # imports python-control

    try:
        found = design_while_running(settings, text, name)
    except (DesignError, ArithmeticError, ValueError) as error:  # the others: numbers that no plant has
        raise NotAdmittedError(" ".join(str(error).split())) from None
    if not found.accepted:
        raise NotAdmittedError(found.verdict())
    return found.as_dict()
