"""A fault in words, with what its trip has found."""

from __future__ import annotations

import math

from rigctl.model import emergency
from rigctl.model.device_states import NMT_WORDS
from rigctl.model.faults import Fault, Trait
from rigctl.model.quantity import Number
from rigctl.model.signals import NEVER_AGE_NS, WATCHED
from rigctl.model.states import EStop

LINGERS = "the drive does not show that it has gone off though it is commanded to"
SPEED, POSITION = "speed", "position"  # by which the drive misses its command
RUNAWAY, MOVES_OFF = "speed grows", "moves though off"

_SEEN: dict[float, str] = {
    EStop.DRIVE: "drive's input",
    EStop.IO_NODE: "I/O node's input",
    EStop.DRIVE | EStop.IO_NODE: "inputs of drive and I/O node",
}

_MISSED = {
    SPEED: "its speed is off by {0:.2f} mm/s (limit {1:g} mm/s)",
    POSITION: "its position is off by {0:.2f} mm (limit {1:g} mm)",
    RUNAWAY: "its speed is beyond any command by {0:.2f} mm/s (limit {1:g} mm/s), and grows; power off at once",
    MOVES_OFF: "it reports that it is not enabled, and moves at {0:.2f} mm/s (limit {1:g} mm/s); power off at once",
}


def fault_text(fault: Fault, value: float, limit: float, text: str = "") -> str:
    """One line for a fault; ``text``: the signal of a limit of the rig file."""
    scale, words = 1e-6 if Trait.AGE in fault.traits else 1.0, fault.words
    if Trait.AGE in fault.traits and value > NEVER_AGE_NS:
        words = words.replace("{value:.0f} ms", "as long as the loop has run")
    return words.format(
        value=Number(value * scale),
        limit=Number(limit * scale),
        text=text,
        found=text and f" ({text})",
        unit=unit_of_limit(text),
        seen=_SEEN.get(value, "input not known"),
        state=_node_words(value, limit),
        missed=_missed_words(value, limit, text),
        not_requested=_not_requested_words(value, limit, text),
        emergency=_emergency_words(value),
    )


def _not_requested_words(value: float, limit: float, text: str) -> str:
    """Of a drive that has power without a command; one that does not show that it has gone off is commanded by none."""
    if text == LINGERS:
        return ""
    speed = f" ({Number(value):.2f} mm/s)" if limit else ""
    return f", and this daemon has not commanded it{speed}: find who commands the drive, withdraw the tool, then reset"


def _emergency_words(value: float) -> str:
    """Node and code of an active emergency: node << 16 | code."""
    node, code = divmod(int(value), 1 << 16) if math.isfinite(value) else (0, 0)
    if not node:
        return "see the events"
    return f"node {node}: 0x{code:04X}, {emergency.code_words(code) if code >> 8 else 'see the events'}"


def _missed_words(value: float, limit: float, text: str) -> str:
    """By how much the drive misses its command; without a limit it is not enabled."""
    if not limit:
        return "it is not enabled"
    # Recordings from before the rows said which have no text.
    return _MISSED.get(text, "its speed or position is off").format(Number(value), Number(limit))


def _node_words(value: float, limit: float) -> str:
    """Time without a heartbeat of a device; its NMT state where ``limit`` is 0."""
    if limit:
        return f"has sent no heartbeat for {Number(value * 1e-6):.0f} ms (limit {Number(limit * 1e-6):.0f} ms)"
    return f"is {NMT_WORDS.get(value, 'in an unknown state')}, not operational: start the daemon anew"


def unit_of_limit(limit: str) -> str:
    """Unit of a limit of the rig file, from its text such as ``tension_n above``."""
    signal, _, words = limit.partition(" ")
    unit = WATCHED[signal].unit if signal in WATCHED else ""
    return f" {unit}{'/s' if 'per second' in words else ''}" if unit else ""
