"""The lease: one holder at a time, for any sequence of requests."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.ipc.notes import Note
from rigctl.model.lease_acts import Denial, is_id
from rigctl.operations.lease import Lease, LeaseChange, LeaseRegister, why_not

S = 1_000_000_000
TERM = 300 * S
ID = "0" * 31 + "1"


@dataclass
class Rig:
    """A register whose ids count up, and its notices."""

    changes: list[LeaseChange] = field(default_factory=list)

    def __post_init__(self) -> None:
        numbers = itertools.count(1)
        self.register = LeaseRegister(TERM, self.changes.append, make_id=lambda: f"{next(numbers):032x}")

    def holder(self, now_ns: int) -> str | None:
        lease = self.register.lease(now_ns)
        return None if lease is None else lease.holder


def granted(found: Lease | Denial) -> Lease:
    assert isinstance(found, Lease)
    return found


def commanded(rig: Rig, operator: str, id_: str | None, now_ns: int) -> Lease | Denial:
    """A command that the rig carries out at once."""
    found = rig.register.admit(operator, id_, now_ns)
    return rig.register.accept(operator, found.id, now_ns) or found if isinstance(found, Lease) else found


def test_the_first_command_takes_the_lease_and_every_further_one_renews_it() -> None:
    rig = Rig()
    first = granted(commanded(rig, "anna", None, 0))
    assert (first.holder, first.since_ns, first.until_ns) == ("anna", 0, TERM)
    again = granted(commanded(rig, "anna", first.id, TERM - 1))
    assert (again.id, again.since_ns, again.until_ns) == (first.id, 0, 2 * TERM - 1)
    assert rig.changes == [LeaseChange(0, Note.LEASE_TAKEN, "anna")]


def test_a_refused_command_neither_takes_nor_renews_the_lease_but_keeps_others_out_until_then() -> None:
    rig = Rig()
    first = granted(rig.register.admit("anna", None, 0))
    assert rig.register.admit("kim", None, 1) is Denial.HELD
    rig.register.refuse("anna", first.id, 2)
    assert rig.register.lease(2) is None
    assert rig.changes == []
    kims = granted(commanded(rig, "kim", None, 3))
    granted(rig.register.admit("kim", kims.id, TERM))
    rig.register.refuse("kim", kims.id, TERM + 1)
    assert rig.register.lease(TERM + 2) == kims
    assert rig.register.lease(TERM + 3) is None


def test_a_takeover_while_the_first_command_runs_is_noted_with_its_giver() -> None:
    rig = Rig()
    first = granted(rig.register.admit("anna", None, 0))
    granted(rig.register.take("kim", None, "a reason", 1))
    rig.register.refuse("anna", first.id, 2)
    assert rig.holder(2) == "kim"
    assert [change.kind for change in rig.changes] == [Note.LEASE_TAKEN, Note.LEASE_TAKEN_OVER]


@pytest.mark.parametrize(
    ("operator", "shown"),
    [("kim", None), ("kim", ID), ("anna", None), ("anna", "f" * 32)],
    ids=["another", "another with the right id", "same name elsewhere", "same name with a wrong id"],
)
def test_a_second_operator_is_refused_while_the_lease_runs(operator: str, shown: str | None) -> None:
    rig = Rig()
    assert granted(commanded(rig, "anna", None, 0)).id == ID
    assert rig.register.admit(operator, shown, TERM - 1) is Denial.HELD
    assert rig.register.take(operator, shown, "", TERM - 1) is Denial.HELD  # a takeover needs a reason
    assert rig.register.give_back(operator, shown, TERM - 1) is Denial.HELD
    assert rig.register.accept(operator, shown, TERM - 1) is None
    assert rig.register.lease(TERM - 1) == Lease(ID, "anna", 0, TERM)


def test_a_takeover_is_noted_with_both_names_and_the_reason() -> None:
    rig = Rig()
    old = granted(commanded(rig, "anna", None, 0))
    new = granted(rig.register.take("kim", None, "anna left", 5))
    assert new.id != old.id
    assert rig.changes[-1] == LeaseChange(5, Note.LEASE_TAKEN_OVER, "kim", "anna", "anna left")
    assert rig.register.admit("anna", old.id, 6) is Denial.HELD
    assert granted(rig.register.admit("kim", new.id, 7)).holder == "kim"


def test_a_lapsed_id_is_not_taken_for_a_new_one() -> None:
    rig = Rig()
    old = granted(commanded(rig, "anna", None, 0))
    assert rig.register.has_lapsed(TERM)
    assert not rig.register.has_lapsed(TERM - 1)
    assert rig.register.admit("anna", old.id, TERM) is Denial.LAPSED
    assert rig.changes == [LeaseChange(0, Note.LEASE_TAKEN, "anna"), LeaseChange(TERM, Note.LEASE_LAPSED, "anna")]
    rig.register.expire(TERM + 1)
    assert len(rig.changes) == 2
    assert granted(rig.register.take("anna", old.id, "", TERM)).id != old.id
    assert rig.changes[-1] == LeaseChange(TERM, Note.LEASE_TAKEN, "anna")


def test_a_lease_given_back_is_anyones() -> None:
    rig = Rig()
    assert rig.register.give_back("anna", None, 0) is Denial.NOT_HELD
    lease = granted(commanded(rig, "anna", None, 0))
    assert rig.register.give_back("anna", lease.id, 1) is None
    assert rig.changes[-1] == LeaseChange(1, Note.LEASE_RETURNED, "anna")
    assert granted(rig.register.admit("kim", None, 2)).holder == "kim"


def test_ids_are_unguessable_and_have_the_form_of_an_id() -> None:
    register = LeaseRegister(TERM, lambda _change: None)
    ids = {granted(register.take(str(n), None, "test", n)).id for n in range(100)}
    assert len(ids) == 100
    assert all(is_id(id_) for id_ in ids)


def acted(rig: Rig, what: str, operator: str, id_: str | None, now_ns: int) -> Lease | Denial | None:
    match what:
        case "command":
            return commanded(rig, operator, id_, now_ns)
        case "refused command":
            if isinstance(admitted := rig.register.admit(operator, id_, now_ns), Lease):
                rig.register.refuse(operator, admitted.id, now_ns)
        case "give back":
            return rig.register.give_back(operator, id_, now_ns)
        case "look":
            rig.register.expire(now_ns)
        case _:
            return rig.register.take(operator, id_, "a reason" if what == "take for a reason" else "", now_ns)
    return None


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["command", "refused command", "take", "take for a reason", "give back", "look"]),
        st.sampled_from(["anna", "kim"]),
        st.none() | st.integers(0, 5),  # the id shown: none, or one of the newest
        st.integers(0, TERM + S),
    ),
    max_size=40,
)


@given(STEPS)
def test_any_sequence_has_one_holder_who_lost_it_only_in_ways_that_are_noted(steps: list[Any]) -> None:
    """The notices alone give the holder at every moment, and never two holders."""
    rig, now, ids = Rig(), 0, ["f" * 32]
    holder: str | None = None
    for what, operator, shown, pause_ns in steps:
        now += pause_ns
        before, until_ns = rig.register.lease(now), 0
        id_ = None if shown is None else ids[-1 - shown % len(ids)]
        rig.changes.clear()
        found = acted(rig, what, operator, id_, now)
        for change in rig.changes:
            assert change.t_ns == now
            match change.kind:
                case Note.LEASE_TAKEN:
                    assert holder is None
                    holder = change.operator
                case Note.LEASE_TAKEN_OVER:
                    assert (holder, change.reason, what) == (change.other, "a reason", "take for a reason")
                    holder = change.operator
                case Note.LEASE_LAPSED:
                    assert holder == change.operator
                    assert before is None
                    holder = None
                case Note.LEASE_RETURNED:
                    assert (holder, change.operator, what) == (operator, operator, "give back")
                    holder = None
        lease = rig.register.lease(now)
        if isinstance(found, Lease):
            assert found == lease
            assert (lease.holder, lease.until_ns) == (operator, now + TERM)
            ids.append(found.id)
            until_ns = found.until_ns
        elif before is not None and what != "give back":
            assert lease == before  # refused or only queried: nothing has changed, its time included
        assert rig.holder(now) == (None if rig.register.has_lapsed(now) else holder)
        assert until_ns in (0, now + TERM)


def test_a_denial_says_who_since_when_how_long_and_how_to_take_over() -> None:
    lease = Lease(ID, "anna", 0, TERM)
    how = "since 88 s, for another 212 s; to take it over: rigctl lease take --reason TEXT"
    assert why_not(Denial.HELD, "kim", lease, 88 * S) == f"anna holds the lease, {how}"
    elsewhere = f"anna holds the lease in another terminal or program, {how}"
    assert why_not(Denial.HELD, "anna", lease, 88 * S) == elsewhere
    assert "rigctl lease take" in why_not(Denial.LAPSED, "kim", None, 0)
    assert why_not(Denial.NOT_HELD, "kim", None, 0) == "nobody holds the lease"
    assert ID not in "".join(why_not(denial, "kim", lease, 0) for denial in Denial)
