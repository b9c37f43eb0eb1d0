"""Imports go down only, by the table of ``docs/architecture.md``, and no modules form a circle."""

from __future__ import annotations

import ast
import importlib
import pathlib
import re
from collections.abc import Iterator
from functools import cache

from rigctl.design.kept_results import TAKING_PART
from tests.builders.paths import ROOT

TABLE = "| folder | may import |\n|---|---|\n"


@cache
def allowed() -> dict[str, set[str]]:
    """By row of the table, lowest first: a folder or a module, and what it may import beside itself."""
    rows = (ROOT / "docs/architecture.md").read_text().partition(TABLE)[2].partition("\n\n")[0].splitlines()
    found = [re.findall(r"`([^`]+)`", row) for row in rows]
    return {row[0]: set(row[1:]) for row in found}


def row_of(file: pathlib.Path) -> str | None:
    """The row of a module: the longest one that is its path, or a folder above it."""
    path = file.relative_to(ROOT).as_posix()
    fitting = [row for row in allowed() if path == row or path.startswith(f"{row}/")]
    return max(fitting, key=len, default=None)


def modules() -> list[pathlib.Path]:
    return sorted(file for package in ("rigctl", "hil") for file in (ROOT / package).rglob("*.py"))


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Every node except those that only a type checker reads."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
            yield from walk(child)


def imported(file: pathlib.Path) -> set[pathlib.Path]:
    """Modules of the project that a module imports, at its top or anywhere in it."""
    found = set()
    for node in walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {module(f"{node.module}.{alias.name}") or module(node.module) for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {module(alias.name) for alias in node.names}
    return {path for path in found if path is not None} - {file}


def module(name: str) -> pathlib.Path | None:
    """The file of a module or package of the project."""
    path = ROOT / name.replace(".", "/")
    files = (
        (path.with_suffix(".py"), path / "__init__.py") if name.split(".", maxsplit=1)[0] in ("rigctl", "hil") else ()
    )
    return next((file for file in files if file.is_file()), None)


def test_every_module_imports_what_its_row_allows_and_nothing_else() -> None:
    wrong = []
    for file in modules():
        row = row_of(file)
        for other in imported(file):
            target = row_of(other)
            if row is None or target in (row, None) or other.name == "__init__.py":
                continue
            if target not in allowed()[row]:
                wrong.append(f"{file.relative_to(ROOT)} imports {other.relative_to(ROOT)}")
    assert not wrong


def test_the_table_allows_only_what_is_above_in_it() -> None:
    rows = list(allowed())
    for i, row in enumerate(rows):
        assert allowed()[row] <= set(rows[:i]), row


def test_what_the_table_allows_is_used() -> None:
    used: dict[str, set[str]] = {row: set() for row in allowed()}
    for file in modules():
        if (row := row_of(file)) is not None:
            used[row] |= {target for other in imported(file) if (target := row_of(other)) not in (row, None)}
    assert used == allowed()


def test_no_module_stands_loose_at_the_root() -> None:
    assert {file.name for file in (ROOT / "rigctl").glob("*.py")} == {"__init__.py", "__main__.py"}


MOST = 25
"""Modules of a folder that fit on a screen."""


def test_a_folder_fits_on_a_screen_and_its_face_imports_nothing() -> None:
    crowded = ("rigctl/control", "hil/faults")
    for folder in {file.parent for package in crowded for file in (ROOT / package).rglob("*.py")}:
        assert len(list(folder.glob("*.py"))) <= MOST, folder
        face = ast.parse((folder / "__init__.py").read_text())
        assert ast.get_docstring(face), folder
        assert not imported(folder / "__init__.py"), folder


def test_modules_of_a_folder_import_each_other_in_one_direction() -> None:
    """No circle between modules."""
    below = {file: imported(file) for file in modules()}
    while below:
        lowest = {file for file, others in below.items() if not others & below.keys()}
        assert lowest, f"a circle among {sorted(str(file.relative_to(ROOT)) for file in below)}"
        below = {file: others for file, others in below.items() if file not in lowest}


def test_a_class_has_a_name_of_its_own() -> None:
    """A name in a message, a trace or a search leads to one class."""
    places: dict[str, list[str]] = {}
    for file in modules():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(file.relative_to(ROOT).as_posix())
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_every_module_can_be_imported() -> None:
    for file in modules():
        if file.name != "__main__.py":
            importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))


def test_results_of_the_design_are_kept_by_every_module_that_its_layer_may_use() -> None:
    assert {f"rigctl/{name}" for name in TAKING_PART} == allowed()["rigctl/design"] | {"rigctl/design"}
