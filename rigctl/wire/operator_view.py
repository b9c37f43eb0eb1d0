"""The answers an operator needs at a glance, from a state: what is wrong, what the rig does, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rigctl.config.quantity import number
from rigctl.control.faults import Fault
from rigctl.wire.alarms import Alarm, figure


@dataclass(frozen=True)
class StandingCause:
    """A cause of a fault. ``since_ns``: wall clock, None where it is not known. ``stands``: else it is only latched."""

    fault: str
    text: str
    value: str
    limit: str
    since_ns: int | None
    blocks_reset: bool
    remedy: str
    stands: bool = True


@dataclass(frozen=True)
class OperatorView:
    """One state as it is to be told. ``entry``: whether somebody may walk in, the first word NO or CHECK."""

    causes: tuple[StandingCause, ...]
    does: str
    blocks: str
    next_step: str
    entry: str


_DOES = {
    "DISARMED": "drive off, brake closed: nothing is driven",
    "HOLD": "holds the stroke under power",
    "TENSIONING": "ramps the tension up to {target}",
    "COMPENSATING": "keeps the tension at {target}: the stroke moves by itself",
    "RELEASING": "lowers the tension until the rope is slack, then holds",
}


def view(state: dict[str, Any], alarms: Sequence[Alarm] = ()) -> OperatorView:
    """The view of a state message; of one without a record only that nothing is known.

    ``alarms``: rows as of now, which know since when a latched fault is there whose cause is gone.
    """
    if state.get("mode") is None or not state.get("loop_alive"):
        step = "rigctl doctor; look at the daemon's log, and start it anew"
        return OperatorView((), "not known: the loop writes no records", "", step, "NO: what the rig does is not known")
    causes = _causes(state, alarms)
    flags = state.get("flag_names", [])
    return OperatorView(causes, _does(state, flags), _blocks(state, causes, flags), _next(state, causes),
                        _entry(state, flags))  # fmt: skip


def _causes(state: dict[str, Any], alarms: Sequence[Alarm]) -> tuple[StandingCause, ...]:
    """Causes that stand, and the latched fault where its own cause is gone; none without a latched fault."""
    latched = state.get("fault")
    if not latched:
        return ()
    raw = state.get("causes")
    found = [cause for cause in raw if isinstance(cause, dict)] if isinstance(raw, list) else []
    result = []
    for cause in found:
        name = str(cause.get("fault", ""))
        fault, since = Fault.__members__.get(name, Fault.NONE), cause.get("since_wall_ns")
        value, limit = (figure(fault, key, cause.get(key), str(cause.get("text", ""))) for key in ("value", "limit"))
        result.append(
            StandingCause(
                name,
                str(cause.get("text", "")),
                value,
                limit,
                since if isinstance(since, int) else None,
                bool(cause.get("blocks_reset")),
                fault.remedy,
            )
        )
    if not any(cause.fault == latched for cause in result):
        fault = Fault.__members__.get(str(latched), Fault.NONE)
        row = _row_of(str(latched), str(state.get("fault_text", "")), alarms)
        value, limit, since = (row.value, row.limit, row.last_ns) if row is not None else ("", "", None)
        result.append(StandingCause(str(latched), str(state.get("fault_text", "")), value, limit, since, False,
                                    fault.remedy, stands=False))  # fmt: skip
    return tuple(result)


def _row_of(fault: str, text: str, alarms: Sequence[Alarm]) -> Alarm | None:
    """The newest row of a fault; of a rig file's limit the row of that limit, which begins the fault's text."""
    rows = [row for row in alarms if row.cause == fault or row.cause.startswith(f"{fault} ")]
    own = [row for row in rows if text.startswith(row.cause.partition(" ")[2])]
    return max(own, key=lambda row: row.last_ns, default=None)


def _does(state: dict[str, Any], flags: list[str]) -> str:
    mode = str(state["mode"])
    if mode == "FAULT":
        if "drive_enabled" in flags:
            return "stops the drive, then takes it off power" if "stopping" in flags else "holds the stroke under power"
        return "drive off, brake closed: nothing is driven"
    if mode == "DISARMED" and "arming" in flags:
        return "checks before arming; then the drive comes on"
    target = state.get("target_n")
    words = _DOES.get(mode, mode).format(target=number(target, 1, "N") if isinstance(target, int | float) else "-")
    return f"{words}; then FAULT" if mode == "RELEASING" and state.get("fault") else words


def _blocks(state: dict[str, Any], causes: tuple[StandingCause, ...], flags: list[str]) -> str:
    """What keeps a reset from being accepted; "" without a latched fault."""
    if not state.get("fault"):
        return ""
    blocking = [cause.fault for cause in causes if cause.stands and cause.blocks_reset]
    if "stopping" in flags:
        blocking.append("the drive is still stopping")
    return ", ".join(blocking) if blocking else "nothing: a reset is accepted"


def _next(state: dict[str, Any], causes: tuple[StandingCause, ...]) -> str:
    if state.get("fault"):
        first = next((cause for cause in causes if cause.stands and cause.blocks_reset), None)
        if first is not None:
            return _then_reset(first.remedy)
        if not any(cause.stands for cause in causes):
            return f"Reset: no cause stands any more. Before that: {causes[0].remedy}"
        return _then_reset(causes[0].remedy)
    failing = ((state.get("preflight") or {}).get("failing") or {}) if state["mode"] == "DISARMED" else {}
    return f"Before arming: {next(iter(failing.values()))}" if failing else ""


def _then_reset(remedy: str) -> str:
    return remedy if "reset" in remedy else f"{remedy} Then reset."


def _entry(state: dict[str, Any], flags: list[str]) -> str:
    """No promise of safety: the lock-out at the rig makes it safe, not this program."""
    if (state.get("quality") or {}).get("drive", "good") != "good":
        return "NO: nothing valid is heard of the drive"
    if "drive_enabled" in flags:
        return "NO: the drive is on, the stroke may move at any time"
    tension = state.get("tension_n")
    carries = number(tension, 1, "N") if isinstance(tension, int | float) else "an unknown tension"
    return f"CHECK: the drive is off, rope and brake carry {carries}; lock the drive out first"
