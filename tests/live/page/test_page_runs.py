"""The view of recorded runs in a real browser: listed, made into files, noted."""

from __future__ import annotations

import os
import pathlib
import zipfile

from playwright.sync_api import Browser

from rigctl.ipc.runtime_folder import ACTIVE, RECORDED
from rigctl.recorder import parts
from tests.builders.miniature import Daemon
from tests.builders.operators import KIM
from tests.builders.pages import PageView, Server, look
from tests.builders.synthetic import compensating, no_error, write
from tests.builders.waiting import until

BEGAN_NS = 1_795_000_000 * 10**9


def runs_of(daemon: Daemon, folder: pathlib.Path) -> None:
    """Two runs and a dump in the folders of a daemon."""
    rig, recordings, trips = daemon.settings.rig, folder / "recordings", folder / "trips"
    for made in (recordings, trips):
        made.mkdir()
    write(parts.path_of(recordings, rig, 7, BEGAN_NS, "0001"), compensating(no_error))
    parts.path_of(recordings, rig, 6, BEGAN_NS, "0001").write_bytes(b"no recording")
    parts.path_of(trips, rig, 2, BEGAN_NS, "DRIVE_FAULT").write_bytes(b"no recording")
    status = {
        "rig": rig, "recording": {"folder": str(recordings), "file": None}, "trips": str(trips),
        "audit_log": str(folder / "audit.jsonl"),
    }  # fmt: skip
    daemon.runtime.write_json(RECORDED, status)
    daemon.runtime.write_json(ACTIVE, {**daemon.runtime.read_json(ACTIVE), "pid": os.getpid()})


def opened(chromium: Browser, page: Server) -> PageView:
    seen = look(chromium, page.address, 1366, 768)
    seen.live()
    seen.run("rigctl.see('runs')")
    seen.until("document.querySelectorAll('#run-table tbody tr').length === 3")
    return seen


def fetched(seen: PageView, run: str, what: str) -> pathlib.Path:
    with seen.page.expect_download() as download:
        seen.page.click(f"#run-table [data-run='{run}'][data-file='{what}']")
    return pathlib.Path(download.value.path())


def test_runs_are_listed_and_made_into_files(
    chromium: Browser, own: Daemon, own_page: Server, tmp_path: pathlib.Path
) -> None:
    runs_of(own, tmp_path)
    seen = opened(chromium, own_page)
    rows = seen.run("[...document.querySelectorAll('#run-table tbody tr')].map((row) => row.cells[0].textContent)")
    assert rows == ["trip-2", "7", "6"]
    assert "Test report" in fetched(seen, "7", "report").read_text()
    assert "<svg" in fetched(seen, "7", "picture").read_text()
    with zipfile.ZipFile(fetched(seen, "7", "csv")) as tables:
        assert any(name.endswith("records.csv") for name in tables.namelist())
    seen.page.click("#run-table [data-run='6'][data-file='report']")
    seen.until("document.querySelector('#runs-said').textContent.includes('0001.mcap')")  # why not, in one line
    seen.page.close()


def test_a_note_goes_on_record(chromium: Browser, own: Daemon, own_page: Server, tmp_path: pathlib.Path) -> None:
    runs_of(own, tmp_path)
    seen = opened(chromium, own_page)
    seen.page.fill("#note-text", "hinge greased")
    seen.page.click("#note button")
    with own.client() as client:
        notes = until(lambda: [one for one in client.past_events() if one["kind"] == "OPERATOR_NOTE"], "the note")
    assert (notes[0]["operator"], notes[0]["reason"]) == (KIM, "hinge greased")
    seen.until("document.querySelector('#note-text').value === ''")
    seen.page.close()


def test_without_recordings_here_the_view_says_where_they_are(chromium: Browser, own: Daemon, own_page: Server) -> None:
    own.client().close()
    seen = look(chromium, own_page.address, 390, 844)
    seen.live()
    seen.run("rigctl.see('runs')")
    seen.until("document.querySelector('#runs-said').textContent.includes('no daemon on this computer')")
    seen.page.close()


def test_a_run_of_another_name_and_another_file_are_refused(
    own: Daemon, own_page: Server, tmp_path: pathlib.Path
) -> None:
    runs_of(own, tmp_path)
    for path in ("runs/7/etc", "runs/last%2F..%2F..%2Fetc/report", "runs/99/report"):
        status, _, body = own_page.ask("GET", f"/api/{path}", **own_page.session)
        assert status in (404, 409), (path, body)
        assert b"Traceback" not in body
