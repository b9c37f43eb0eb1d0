"""The terminal's screen and the page show the same, and both show which limits are exceeded."""

from __future__ import annotations

from typing import Any

from rigctl.cli.watch_screen import Screen
from rigctl.client.rig_view import RigView
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.page.panel import state_message
from rigctl.page.picture import Picture
from rigctl.wire.passed_limits import PassedLimits
from tests.builders.miniature import Daemon


def limit(kind: Kind, text: str, value: float, bound: float, seq: int) -> dict[str, Any]:
    """An event as the gateway words it."""
    said = worded(kind, Fault.LIMIT, Action.LOG, value, bound, text)
    words = {"kind": kind.name, "text": said.text, "severity": said.severity}
    return {"seq": seq, "t_ns": seq, "wall_ns": 0, "a": int(Fault.LIMIT), "about": text, "limit": bound, **words}


EVENTS = [
    limit(Kind.LIMIT, "stroke_mm above", 118.2, 117.0, 1),
    limit(Kind.LIMIT, "lateness_us above", 2613.0, 2000.0, 2),
    limit(Kind.LIMIT, "stroke_mm below", -18.0, -17.0, 3),
    limit(Kind.LIMIT_OVER, "lateness_us above", 1.0, 2000.0, 4),
]


def test_a_limit_is_passed_until_it_is_kept_again() -> None:
    passed = PassedLimits()
    for event in EVENTS:
        passed.note(event)
    assert passed.now == ["stroke_mm above 117 mm (118.2 mm)", "stroke_mm below -17 mm (-18 mm)"]
    passed.note(limit(Kind.LIMIT_OVER, "stroke_mm above", 0.0, 117.0, 5))
    assert passed.now == ["stroke_mm below -17 mm (-18 mm)"]
    passed.note({"kind": "STARTED", "text": "loop started, DISARMED"})
    assert passed.now == []


def test_terminal_and_page_say_the_same_of_a_real_daemon(daemon: Daemon) -> None:
    with daemon.client() as client:
        state = client.state()
    recorded = {"entries": 7, "failures": 2, "head": "0"}
    state |= {"audit": recorded, "trip_dump": "trips/one.mcap", "recording": {"file": "one.mcap", "records_lost": 3}}
    state |= {"flag_names": ["drive_enabled", "limited_speed"]}
    view, picture = RigView(daemon.endpoint, daemon.settings.rig), Picture(daemon.endpoint)
    for shown in (view, picture):
        shown.take_state(state)
        shown.add_events(EVENTS)
    screen = "\n".join(line.plain for line in Screen(view).lines(200, 60))
    page = state_message(picture, holds_lease=False)
    assert page["limits"] == view.limits.now
    for words in (
        page["calibration"][0], page["recorder"][0], page["lease"]["text"], page["lateness"], page["bus"],
        page["flags"], *page["limits"], *(words for words, _ in page["checks"]), *page["warnings"],
    ):  # fmt: skip
        assert words
        assert words in screen
    assert page["recorder"] == (
        "audit log 7 entries, recording one.mcap, 3 records lost, 2 writes failed, trip dump trips/one.mcap", "yellow",
    )  # fmt: skip
    assert page["flags"] == "limited speed"
