"""What an operator gives: a command, or an act on the lease, as values."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rigctl.model.lease_acts import LeaseAct
from rigctl.model.verbs import Verb


@dataclass(frozen=True)
class Request:
    """A command as an operator gives it.

    ``value``: target of TARGET or known weight of CALIBRATE in N, stroke of CONFIRM_STROKE in mm,
    number of a MOVE, time of a CARRY in s, length of a RELEASE of a slack rope in mm, else NaN.
    ``shunt``: CALIBRATE compares with the shunt. ``adopt``: it sets a new scale, or the creep. ``creep_s``: it records
    the creep for so long, NaN for a mean. ``tight``: IDENTIFY needs a tight rope. ``near_end``: ARM at an end of the
    stroke, to drive away from it. ``where``: RESPONSE only in that mode, hold or compensating; empty for the mode that
    it is in. ``supported``: BRAKE_TEST has the payload supported from below.
    ``by``: CARRY or LOWER by encoder or cell alone; empty for both.
    ``gain_file``, ``name``: text and name of a gain file, for GAINS.
    ``lease``: id of the lease it is given under, None without one.
    ``run_id``: run of the daemon it is meant for, empty for any.
    """

    verb: Verb
    operator: str
    value: float = math.nan
    shunt: bool = False
    adopt: bool = False
    tight: bool = False
    lease: str | None = None
    gain_file: str = ""
    name: str = ""
    near_end: bool = False
    supported: bool = False
    where: str = ""
    run_id: str = ""
    creep_s: float = math.nan
    by: str = ""

    @property
    def command(self) -> str:
        """The command's name, as its key ends."""
        return self.verb.name.lower()

    @property
    def numbers(self) -> tuple[float, ...]:
        """The numbers in the command's slot, in the order of `rigctl.model.verbs.VALUES`."""
        return tuple(
            option.choices[getattr(self, option.name)] if option.choices else float(getattr(self, option.name))
            for option in self.verb.row.options if option.field is not None
        )  # fmt: skip

    @property
    def number(self) -> float:
        """The first of them; NaN for none."""
        return next(iter(self.numbers), math.nan)


@dataclass(frozen=True)
class LeaseRequest:
    """An operator's request to take or return the lease; ``reason`` may be empty. The others: see `Request`."""

    act: LeaseAct
    operator: str
    lease: str | None = None
    reason: str = ""
    run_id: str = ""

    @property
    def command(self) -> str:
        """The request's name, as its key ends."""
        return self.act.value
