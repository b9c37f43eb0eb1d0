"""The rate limit of commands."""

from __future__ import annotations

from rigctl.operations.command_rate import (
    ALL_BURST,
    ALL_HZ,
    NAMES_MAX,
    PER_OPERATOR_BURST,
    PER_OPERATOR_HZ,
    REPORT_NS,
    Flow,
)

S = 1_000_000_000


def let_through(flow: Flow, names: list[str], seconds: int, *, holder: bool = False) -> list[str]:
    """Names of the commands let through, of a thousand a second."""
    found = []
    for number in range(1000 * seconds):
        name = names[number % len(names)]
        if not flow.admit(name, S + number * 1_000_000, holder=holder):
            found.append(name)
    return found


def test_one_operator_has_a_burst_and_then_a_rate() -> None:
    assert abs(len(let_through(Flow(S), ["kim"], 10)) - PER_OPERATOR_BURST - 10 * PER_OPERATOR_HZ) <= 1


def test_many_names_meet_the_limit_of_all() -> None:
    names = [f"user{number}" for number in range(1000)]
    assert abs(len(let_through(Flow(S), names, 10)) - ALL_BURST - 10 * ALL_HZ) <= 1


def test_a_flood_under_one_name_takes_nothing_from_another() -> None:
    flow = Flow(S)
    for number in range(10_000):
        flow.admit("flood", S + number * 1_000_000)
        if not number % 200:
            assert flow.admit("anna", S + number * 1_000_000) == ""


def test_the_holder_gets_through_a_flood_under_many_names() -> None:
    flow = Flow(S)
    for number in range(10_000):
        flow.admit(f"user{number}", S + number * 1_000_000)
        if not number % 100:
            assert flow.admit("anna", S + number * 1_000_000, holder=True) == ""


def test_the_holder_has_a_limit_too() -> None:
    assert len(let_through(Flow(S), ["anna"], 10, holder=True)) <= PER_OPERATOR_BURST + 10 * PER_OPERATOR_HZ + 1


def test_refusals_are_counted_by_name_and_reported_once() -> None:
    flow = Flow(S)
    through = len(let_through(flow, ["kim"], 5))
    assert not flow.due(S + 5 * S)
    assert flow.due(S + REPORT_NS + S)
    (crowd,) = flow.report()
    assert (crowd.operator, crowd.count) == ("kim", 5000 - through)
    assert flow.report() == []
    assert not flow.due(100 * S)


def test_names_without_end_take_no_memory_without_end() -> None:
    flow = Flow(S)
    for number in range(50_000):
        flow.admit(f"user{number}", S + number)
    assert len(flow._of) <= NAMES_MAX
    assert len(flow.report()) <= NAMES_MAX + 1


def test_the_refusal_says_what_the_limit_is_and_what_to_do() -> None:
    flow = Flow(S)
    why = [flow.admit("kim", S) for _ in range(PER_OPERATOR_BURST + 1)][-1]
    assert why.startswith(
        f"too many commands: more than {PER_OPERATOR_HZ} a second from one operator; it was not given"
    )
