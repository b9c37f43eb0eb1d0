"""What was added within a window, and in all."""

from __future__ import annotations

from rigctl.control.bus.recent_count import RecentCount


def test_what_is_older_than_the_window_counts_in_the_total_alone() -> None:
    recent = RecentCount(10)
    for now_ns, number, count in ((0, 3, 3), (10, 0, 3), (11, 2, 2), (21, 0, 2), (22, 0, 0)):
        if number:
            recent.add(now_ns, number)
        recent.look(now_ns)
        assert recent.count == count
    assert recent.total == 5
