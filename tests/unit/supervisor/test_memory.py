"""Every process of the daemon has a share of memory, and the loop is the last one to be killed."""

from __future__ import annotations

from rigctl.supervisor import daemon as supervisor
from rigctl.supervisor import memory


def test_every_process_has_a_share() -> None:
    assert set(memory.SHARES) == set(supervisor.PROCESSES) | set(supervisor.PAGE)


def test_the_loop_is_ended_last() -> None:
    order = sorted(memory.SHARES, key=lambda name: memory.SHARES[name].oom_score_adj)
    assert order[0] == "control"
