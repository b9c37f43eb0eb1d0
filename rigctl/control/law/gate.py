"""Innovation gate of one sensor: it accepts or rejects samples, and measures their distribution (NIS)."""

from __future__ import annotations

from rigctl.model.samples import Verdict

NIS_SAMPLES = 1000
"""Window of the running mean of NIS, in samples."""


# As numbers: a member's .value is a function call.
_ABSENT, _USED, _REJECTED, _IDLE = map(int, Verdict)


class Gate:
    """Believes an innovation y of variance S while ``y^2 <= sigma^2 (S + (burst (n + 1))^2)``.

    n counts ticks since a sample was believed, and a jolt may have begun within the one before; ``burst`` is the change
    of the quantity in a tick beyond the filter's model, one sigma. An innovation beyond sigma alone is believed only
    where the one before was beyond it on the same side: noise is so once in half an hour, a filter that follows it is
    surprised by the next sample too, the other way, and so on. A spike is rejected, a jolt is followed from its second
    sample on (``surprised`` makes the filter follow it faster), and a jump no rig can make is rejected for so many
    ticks that it becomes a fault.

    Args:
        sigma: width of the gate.
        burst: per tick, in the sensor's unit.
    """

    __slots__ = (
        "_beyond",
        "_burst2",
        "_forget",
        "_sigma2",
        "innovation",
        "nis",
        "rejects",
        "since",
        "surprised",
        "variance",
        "verdict",
    )

    def __init__(self, sigma: float, burst: float) -> None:
        self._sigma2 = sigma * sigma
        self._burst2 = burst * burst
        self._forget = 1.0 / NIS_SAMPLES
        self._beyond = 0.0
        """The last innovation where it was beyond sigma alone, else 0."""
        self.innovation = 0.0
        self.variance = 0.0
        self.verdict = _ABSENT
        self.rejects = 0
        """Consecutive samples outside the gate."""
        self.since = 1
        """Ticks since the last sample that was believed, this one included."""
        self.surprised = False
        """The last sample was believed only because of the burst term."""
        self.nis = 1.0
        """Running mean of y^2 / S over the samples within sigma; 1 where the filter's model is right."""

    def go_on_from(self, other: Gate) -> None:
        """Take over what another filter's gate has counted."""
        self.since, self.rejects, self.verdict, self.nis = other.since, other.rejects, other.verdict, other.nis
        self.innovation, self.variance, self.surprised = other.innovation, other.variance, other.surprised
        self._beyond = other._beyond

    def believes(self, innovation: float | None, variance: float) -> bool:
        """Judge one sample, None is an absent one; its innovation and variance stay for the record."""
        if innovation is None:
            self.absent()
            return False
        self.innovation, self.variance = innovation, variance
        n = self.since + 1
        square = innovation * innovation
        beyond = square > self._sigma2 * variance
        self.surprised = (
            beyond and innovation * self._beyond > 0.0 and square <= self._sigma2 * (variance + self._burst2 * n * n)
        )
        self._beyond = innovation if beyond else 0.0
        if beyond and not self.surprised:
            self.verdict = _REJECTED
            self.rejects += 1
            return False
        self.verdict = _USED
        self.rejects = 0
        self.since = 0
        if not self.surprised:
            self.nis += self._forget * (square / variance - self.nis)
        return True

    def absent(self) -> None:
        """No sample in this tick."""
        self.verdict = _ABSENT
        self.innovation = 0.0
        self.surprised = False

    def idle(self) -> None:
        """Start again, as nothing is estimated on a slack rope."""
        self.verdict = _IDLE
        self.innovation = self._beyond = 0.0
        self.rejects = self.since = 0

    def pass_ticks(self, periods: int) -> None:
        """Advance the time by ``periods`` ticks."""
        self.since += periods
