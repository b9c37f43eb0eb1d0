"""One rig for all that runs in the guest."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.guest.inside.guest_rig import TARGET_N, GuestRig


@pytest.fixture(scope="session")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuestRig]:
    """Running, DISARMED, the rope slack, its target ``TARGET_N``."""
    with GuestRig(tmp_path_factory.mktemp("rig")) as subject:
        subject.carried_out("target", TARGET_N)
        yield subject
