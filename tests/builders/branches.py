"""A test that goes on from a start which others have too: it is played once, each test runs in a forked process.

What such a test changes is gone with its process, so that every test finds the start as it was.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from hil.branching import BranchPoint
from hil.lockstep import Lockstep

_BRANCH_POINT = pytest.StashKey[BranchPoint]()


class Started(NamedTuple):
    """A rig at a start."""

    rig: Lockstep
    branch_point: BranchPoint

    @classmethod
    def now(cls, rig: Lockstep) -> Started:
        """The rig as it is: it is not to go on in this process."""
        return cls(rig, BranchPoint(rig.runtime.directory))

    def go_on(self, request: pytest.FixtureRequest) -> Lockstep:
        """The rig for the test that made this request, which is run in a process of its own."""
        request.node.stash[_BRANCH_POINT] = self.branch_point
        return self.rig


def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that goes on from a start."""
    branch_point = pyfuncitem.stash.get(_BRANCH_POINT, None)
    if branch_point is None:
        return None
    values = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    if words := branch_point.branch(functools.partial(_failure, pyfuncitem, values)):
        pytest.fail(words, pytrace=False)
    return True


def _failure(item: pytest.Function, values: dict[str, Any]) -> str:
    """Why the test failed, as pytest shows it; "": it passed."""
    test: Callable[..., None] = item.obj
    try:
        test(**values)
    except BaseException:  # noqa: BLE001 - nothing may leave a forked process
        return str(item.repr_failure(pytest.ExceptionInfo.from_current()))
    return ""
