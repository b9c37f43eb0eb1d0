"""The holding brake: its armature takes its time, and its defects outlast every command."""

from __future__ import annotations

import pytest

from hil.nodes.brake import Brake

MS = 1_000_000


@pytest.fixture
def brake() -> Brake:
    return Brake(40 * MS, 20 * MS)


def closed_at(brake: Brake, *ms: int) -> list[bool]:
    found = []
    for at in ms:
        brake.advance(at * MS)
        found.append(brake.closed)
    return found


def test_it_opens_and_closes_each_in_its_own_time(brake: Brake) -> None:
    assert closed_at(brake, 0, 100) == [True, True]
    brake.energise(True, 100 * MS)
    assert closed_at(brake, 139, 140, 200) == [True, False, False]
    brake.energise(True, 200 * MS)
    brake.energise(False, 300 * MS)
    assert closed_at(brake, 319, 320) == [False, True]


def test_called_off_while_it_opens_it_stays_closed(brake: Brake) -> None:
    brake.energise(True, 0)
    assert closed_at(brake, 30) == [True]
    brake.energise(False, 30 * MS)
    assert closed_at(brake, 31, 49, 100) == [True, True, True]


@pytest.mark.parametrize(("defect", "closed"), [("stuck_closed", True), ("stuck_open", False)])
def test_a_stuck_armature_ignores_its_current_until_it_is_restored(brake: Brake, defect: str, closed: bool) -> None:
    setattr(brake, defect, True)
    assert closed_at(brake, 100) == [closed]
    brake.energise(True, 100 * MS)
    assert closed_at(brake, 300) == [closed]
    brake.restore()
    assert closed_at(brake, 300) == [False]
