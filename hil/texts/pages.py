"""Pages and schemas that are made from the code, files of the live page, and every sentence in the program's source."""

from __future__ import annotations

import ast
import json
import pathlib
import re
from collections.abc import Iterator
from typing import Any

import hil
import rigctl
import rigctl.page
from hil.faults import processes
from hil.faults.catalogue import CATALOGUE
from hil.faults.fault_tables import page_row
from rigctl.config.settings import RigSettings
from rigctl.control import diagram
from rigctl.wire.schema import schema

_PROSE = re.compile(r"\w \w")
_NOT_OURS = "uplot."


def pages(rig: RigSettings) -> dict[str, str]:
    """All of them by name; the sentences of a program are sorted, wherever they are in it."""
    rows = "\n".join([*map(page_row, CATALOGUE), *map(page_row, processes.CATALOGUE)])
    made = {
        "page docs/modes.md": diagram.document(),
        "page docs/faults.md, its table": rows,
        "schema meta/schema": json.dumps(schema(rig.rig), indent=2),
    }
    static = pathlib.Path(rigctl.page.__file__).parent / "static"
    live = {f"page {file.name}": file.read_text() for file in static.iterdir() if not file.name.startswith(_NOT_OURS)}
    return made | live | {f"sentences {package.__name__}": _sentences(package) for package in (hil, rigctl)}


def _sentences(package: Any) -> str:
    files = pathlib.Path(package.__file__).parent.rglob("*.py")
    found = {text for file in files for text in _strings(ast.parse(file.read_text()), docstring=False)}
    return "\n".join(json.dumps(text, ensure_ascii=False) for text in sorted(found) if _PROSE.search(text))


def _strings(node: ast.AST, *, docstring: bool) -> Iterator[str]:
    """Strings in a part of a program, what is put into them as ``{}``, without docstrings."""
    if isinstance(node, ast.JoinedStr):
        yield _template(node)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not docstring:
        yield node.value
    if isinstance(node, ast.JoinedStr):
        below = [part.value for part in node.values if isinstance(part, ast.FormattedValue)]
    else:
        below = list(ast.iter_child_nodes(node))  # type: ignore[arg-type]
    for child in below:
        yield from _strings(child, docstring=isinstance(node, ast.Expr))


def _template(node: ast.JoinedStr) -> str:
    return "".join(
        str(part.value) if isinstance(part, ast.Constant) else f"{{{_spec(part)}}}" for part in node.values
    )  # fmt: skip


def _spec(part: ast.expr) -> str:
    spec = part.format_spec if isinstance(part, ast.FormattedValue) else None
    return f":{_template(spec)}" if isinstance(spec, ast.JoinedStr) else ""
