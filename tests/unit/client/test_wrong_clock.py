"""A certificate that is not valid by this computer's clock: the message names the clock, if that cannot be right."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from rigctl.client.connection import ChoiceError, Client, NoDaemonError, credentials_of
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import Role
from rigctl.ipc import wall_clock
from tests.builders.daemons import free_port


@pytest.fixture
def _unset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wall_clock, "RELEASED", datetime.now(UTC) + timedelta(days=1))


def key(folder: pathlib.Path, now: datetime) -> pathlib.Path:
    issuer = KeyIssuer(folder / "keys", now)
    issuer.init([])
    issuer.add("kim", Role.OPERATOR, days=1)
    return issuer.folder.issued("kim")


@pytest.mark.usefixtures("_unset")
def test_an_expired_key_and_an_absent_daemon_name_the_clock(tmp_path: pathlib.Path) -> None:
    clock = "; the computer's clock reads .*, which is before the release of rigctl .*: set the clock"
    endpoint = f"tls/127.0.0.1:{free_port()}"
    now = datetime.now(UTC)
    with pytest.raises(ChoiceError, match=f"expired on .*: rigctl keys renew kim{clock}"):
        credentials_of(endpoint, key(tmp_path / "old", now - timedelta(days=3)))
    with pytest.raises(NoDaemonError, match=f"no daemon answers at {endpoint} .*{clock}"):
        Client(endpoint, key=key(tmp_path / "new", now))


@pytest.mark.usefixtures("_unset")
def test_keys_made_by_a_clock_that_is_not_set_are_warned_of(
    tmp_path: pathlib.Path, in_process: Callable[..., Any]
) -> None:
    for task in (["init"], ["list"]):
        done = in_process("rigctl", "keys", *task, "--dir", tmp_path / "keys")
        assert done.returncode == 0
        assert "WARNING: the computer's clock reads " in done.stderr
        assert done.stderr.count("\n") == 1
