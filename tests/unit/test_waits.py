"""No test of the gate waits for a time of this computer's clock; today's exceptions are listed, and only shrink."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator

from tests.builders.paths import ROOT

FOLDERS = ("unit", "loop", "plant", "studies", "builders")
WAITS = {"wait", "join", "communicate", "settimeout", "recv", "get", "poll", "wait_for", "acquire"}
"""Methods whose number is a limit in time; a whole number of `recv` is one of bytes."""
SIMULATED = {"bench", "rig", "other", "self"}
"""Whose `wait` lets simulated time pass."""
ENOUGH_S = 60.0

EXCEPTIONS: dict[str, int] = {
    "unit/client/test_local_hold.py": 1,  # the period of a loop's stand-in
    "unit/hil/test_rigsim_bus.py": 4,  # simulated time, and two that no frame can come to any more
    "unit/hil/test_study_runner.py": 1,  # the length of a piece of work
    "unit/ipc/test_termination.py": 1,
    "unit/soak/test_soak_judge.py": 1,  # a pause that is made
    "unit/supervisor/test_left_processes.py": 1,  # the period of a loop's stand-in
    "unit/test_host_pause.py": 2,  # the same
    "builders/another_version.py": 1,  # the period of a stand-in
    "builders/crowd.py": 1,
    "builders/host_pause.py": 1,
    "builders/intruder.py": 3,
    "builders/late_link.py": 1,
    "builders/page_states.py": 1,
    "builders/stand_in.py": 1,  # the period of a stand-in
    "builders/waiting.py": 1,
}
"""Number of such lines in a file, as they were when the rule was made or fewer."""


def limit(call: ast.Call, name: str, on: str) -> list[ast.expr]:
    """The arguments of a call that are limits in time."""
    limits = [keyword.value for keyword in call.keywords if (keyword.arg or "").startswith("timeout")]
    if name in WAITS and len(call.args) == 1 and not (name == "wait" and on in SIMULATED):
        limits.append(call.args[0])
    return limits


def short(value: ast.expr, name: str) -> bool:
    """Whether a number is a limit that a busy host may exceed."""
    number = value.value if isinstance(value, ast.Constant) else None
    kind = float if name == "recv" else (int, float)
    return isinstance(number, kind) and not isinstance(number, bool) and 0 < number < ENOUGH_S


def waits(tree: ast.AST) -> Iterator[int]:
    """Lines that sleep, or whose limit is shorter than a pause of the host may be."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        on = getattr(node.func.value, "id", "") if isinstance(node.func, ast.Attribute) else ""
        if (on == "time" and name == "sleep") or any(short(value, name) for value in limit(node, name, on)):
            yield node.lineno


def found() -> dict[str, int]:
    count: Counter[str] = Counter()
    for folder in FOLDERS:
        for file in sorted((ROOT / "tests" / folder).rglob("*.py")):
            lines = list(waits(ast.parse(file.read_text())))
            if lines:
                count[file.relative_to(ROOT / "tests").as_posix()] = len(lines)
    return dict(count)


def test_every_browser_and_page_of_a_test_gets_the_patience_of_all_waits() -> None:
    """Playwright's own limit is 30 s; `tests.builders.pages` sets another."""
    own = re.compile(r"(?<!pages)\.(new_page|new_context|launch)\(")
    calls = [
        f"{file.relative_to(ROOT)}: {line.strip()}"
        for file in (ROOT / "tests").rglob("*.py")
        if file.name != "pages.py"
        for line in file.read_text().splitlines()
        if own.search(line)
    ]
    assert calls == []


def test_no_wait_is_added_and_one_that_has_gone_leaves_the_list() -> None:
    assert found() == EXCEPTIONS
