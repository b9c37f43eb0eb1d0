"""The router's access list by a wrong clock, with certificates and a router of Zenoh."""

from __future__ import annotations

import pathlib
from datetime import UTC, datetime, timedelta

import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.telemetry_section import TlsSettings
from rigctl.gateway.admission import Admission
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import Role
from rigctl.ipc import wall_clock
from rigctl.wire.session import close
from tests.builders.daemons import free_port
from tests.builders.paths import ROOT


def test_a_list_made_by_a_clock_that_was_not_set_is_made_again_once_it_is(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = datetime.now(UTC)
    KeyIssuer(tmp_path / "keys", now - timedelta(hours=1)).init([])
    made = KeyIssuer(tmp_path / "keys", now).add("kim", Role.OPERATOR)
    paper = config.load(ROOT / "config/paper_rig.yaml")
    tls = TlsSettings(keys=str(tmp_path / "keys"))
    settings = changed(paper, {"telemetry.listen": f"tls/127.0.0.1:{free_port()}", "telemetry.tls": tls})
    with monkeypatch.context() as patch:
        patch.setattr(wall_clock, "RELEASED", now + timedelta(days=1))
        admission = Admission(settings)
        session = admission.open_router(f"unixsock-stream/{tmp_path}/socket", again=False)
        assert not admission.has_changed()
    try:
        assert admission.dates == {"the certificate of kim": made.not_before}
        assert admission.has_changed()
    finally:
        close(session)
