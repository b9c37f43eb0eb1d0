"""A short run of ``python -m tests.bench access``: nothing is dropped for as long as a client runs."""

from __future__ import annotations

import os

import pytest

from tests.bench import access

SECONDS = float(os.environ.get("RIGCTL_ACCESS_SOAK_S", "15"))


@pytest.mark.study
def test_renewed_subscriptions_and_commands_go_on_for_as_long_as_clients_run() -> None:
    found = access.measure(SECONDS, clients=4, changes=1)
    assert (found["lost"], found["renewals_silent"], found["commands_refused"]) == (0, 0, 0)
    assert found["changes"] == 1 and found["renewals"] > 1 and found["fewest_received"] > 0
