"""A device's own clock: quartzes differ, and every timer of a device runs on its own."""

from __future__ import annotations

GRID_NS = 1_000_000
"""Drive ramps, brake, encoder, filters, inclinometer, plain frames and truth log go on this grid, however often the rig
is advanced."""


class DeviceClock:
    """Reads as the rig's clock at ``start_ns`` and gains ``ppm`` parts per million on it from there."""

    __slots__ = ("_ppb", "_start_ns")

    def __init__(self, start_ns: int, ppm: float) -> None:
        self._start_ns = start_ns
        self._ppb = round(ppm * 1000.0)

    def local_ns(self, t_ns: int) -> int:
        """Device time at the rig's ``t_ns``."""
        elapsed_ns = t_ns - self._start_ns
        return t_ns + elapsed_ns * self._ppb // 1_000_000_000

    def span_ns(self, elapsed_ns: int) -> int:
        """Device time that passes in ``elapsed_ns`` of the rig's time."""
        return elapsed_ns + elapsed_ns * self._ppb // 1_000_000_000
