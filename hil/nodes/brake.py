"""The cylinder's holding brake, closed by springs: it opens, and closes, some time after its current changes."""

from __future__ import annotations


class Brake:
    """Armature in time, and its defects, which an injector sets and takes back.

    Args:
        open_ns: from current on until the armature is free.
        close_ns: from current off until it holds.
    """

    __slots__ = ("_close_ns", "_closed", "_energised", "_open_ns", "_since_ns", "drag_n", "late_ns", "slip_mm_s",
                 "stuck_closed", "stuck_open")  # fmt: skip

    def __init__(self, open_ns: int, close_ns: int) -> None:
        self._open_ns, self._close_ns = open_ns, close_ns
        self._energised, self._closed = False, True
        self._since_ns = 0
        self.restore()

    def restore(self) -> None:
        """Take every defect away."""
        self.stuck_closed = False  # does not open, or has closed by itself
        self.stuck_open = False  # does not hold
        self.drag_n = 0.0  # friction, as rope force, of an armature that opens only partly
        self.late_ns = 0  # by which it closes later
        self.slip_mm_s = 0.0  # speed at which it lets a load down while it is closed

    @property
    def closed(self) -> bool:
        """Whether the armature is pressed on."""
        return self.stuck_closed or (self._closed and not self.stuck_open)

    def energise(self, on: bool, t_ns: int) -> None:
        """Switch its current; the same again changes nothing."""
        if on is not self._energised:
            self._energised, self._since_ns = on, t_ns

    def advance(self, t_ns: int) -> None:
        """Advance the armature to ``t_ns``."""
        if t_ns - self._since_ns >= (self._open_ns if self._energised else self._close_ns + self.late_ns):
            self._closed = not self._energised
