"""``rigctl alarms``: one row for each cause, the first to look at first."""

from __future__ import annotations

import time

from rigctl.cli.options import BAD, DONE, Connect, Json, Rig, daemon, end, say, say_json


def alarms(json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Show the alarms: priority, cause, how often, since when, and what to do. Exit code 1 while one stands."""
    from rigctl.wire.alarm_words import block
    from rigctl.wire.alarms import Alarms, as_message

    with daemon(connect, rig) as client:
        known = Alarms(client.past_events())
        rows = known.rows(client.state(), now_ns := time.time_ns())
    if json:
        say_json([as_message(row, now_ns) for row in rows])
    for row in [] if json else rows:
        say("\n".join(block(row, now_ns)))
    if not rows and not json:
        say("no alarms")
    end(BAD if any(row.stands and not row.shelved(now_ns) for row in rows) else DONE)
