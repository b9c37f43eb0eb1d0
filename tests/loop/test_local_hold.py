"""HOLD of a user of this computer: carried out before every waiting command, and not undone by an earlier one."""

from __future__ import annotations

from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.bus.hold_sockets import Hold
from rigctl.control.law.tension import Gains
from rigctl.control.modes import command_slot
from rigctl.ipc.record import HOLD_ID
from rigctl.model.events import Kind, worded
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb


def tensioning(rig: Lockstep) -> None:
    rig.run(0.3)
    rig.command(Setting.HOST_CHECKS, 0.0)
    assert rig.command(Verb.ARM) is Refusal.NONE
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(0.5)
    assert rig.loop.machine.mode is Mode.TENSIONING


def test_a_hold_is_taken_in_the_next_tick_and_the_record_shows_it(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains) as rig:
        tensioning(rig)
        replies = rig.runtime.replies.reader()
        rig.holds.append(Hold(1000, 4711, "Zoë"))
        (record,) = rig.run(0.001)
        assert (record["mode"], record["hold_seq"], record["command_seq"]) == (Mode.HOLD, 1, 3)
        (reply,) = replies.read()
        assert (reply["id"], reply["accepted"], reply["mode"]) == (HOLD_ID | int(record["t_ns"]), 1, Mode.HOLD)
        slot = next(slot for slot in rig.events.read() if slot["kind"] == Kind.LOCAL_HOLD)
        event = worded(Kind.LOCAL_HOLD, int(slot["a"]), int(slot["b"]), 0.0, 0.0, slot["text"].decode())
        assert event.text == "HOLD from Zoë via the local socket (uid 1000, process 4711)"


def test_commands_that_wait_neither_delay_nor_undo_a_hold(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains) as rig:
        tensioning(rig)
        given_ns = rig.clock.now()
        for number in range(400):  # a hundred ticks' worth
            rig._commands.write(*command_slot(given_ns, 1000 + number, Verb.RELEASE if number % 2 else Verb.TENSION))
        rig.holds.append(Hold(0, 0, "kim"))
        replies = rig.runtime.replies.reader()
        records = rig.run(0.2)
        assert set(records["mode"]) == {Mode.HOLD}
        assert records["hold_seq"][0] == 1
        found = replies.read()
        (held,) = found[found["id"] >= HOLD_ID]
        assert (held["accepted"], held["t_ns"]) == (1, records["t_ns"][0])
        others = found[found["id"] < HOLD_ID]
        assert set(others["reason"]) == {Refusal.ABORTED}
        assert len(others) == 400
        assert rig.command(Verb.TENSION) is Refusal.NONE  # a later command is carried out


def test_of_holds_that_wait_a_tick_takes_one_and_a_hold_that_has_waited_is_carried_out(
    settings: RigSettings, gains: Gains
) -> None:
    with lockstep(settings, gains) as rig:
        tensioning(rig)
        rig.holds.extend(Hold(1000 + number, 1, "kim") for number in range(5))
        records = rig.run(0.006)
        assert records["hold_seq"].tolist() == [1, 2, 3, 4, 5, 5]
        assert set(records["mode"]) == {Mode.HOLD}
        slots = rig.runtime.holds.reader(from_start=True).read()
        assert slots["uid"].tolist() == [1000, 1001, 1002, 1003, 1004]
        assert slots["t_ns"].tolist() == records["t_ns"][:5].tolist()
