"""Preflight checks that fail, in words."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from rigctl.model.checks import Check


def failed_checks(bits: int, known: Mapping[Check, str] = MappingProxyType({})) -> list[str]:
    """Preflight checks that failed, in words; ``known``: details of some of them."""
    return [known.get(check, check.words) for check in Check if bits & check]


def setting_words(text: str) -> str:
    """The setting a device does not keep, and what to do."""
    return f"a device does not keep what start-up wrote, {text}: start the daemon anew, it writes all of it again"


def stroke_words(reads_mm: float, why: str) -> str:
    """Why a stroke has to be confirmed, and what to do."""
    return (
        f"the stroke reads {reads_mm:z.2f} mm, but {why}: measure it at the cylinder; if it is {reads_mm:z.2f} mm, "
        f"rigctl confirm-stroke {reads_mm:z.2f}, else home the drive with its own tool"
    )
