"""``python -m hil.cli.reference ROOT``: JSON Schemas of rig and scenario file, and the page of their keys.

Both come from the settings themselves: types, bounds, defaults and descriptions. It writes ``config/schema/`` and
``docs/rig-file.md`` below ROOT.
"""

from __future__ import annotations

import json
import pathlib
import sys
from typing import Any

from hil.scenario.format import Scenario
from rigctl.config import bounds, rig_file
from rigctl.config.settings import ADDED, RigSettings

Node = dict[str, Any]
PAGE = "docs/rig-file.md"
_HEAD = """# Keys of rig file and scenario file

Generated from the settings by `python -m hil.cli.reference .`; do not edit. Every key that is not listed is refused. A
key without a default is required. Units are in the names. `rigctl check FILE` finds more: values that are valid alone
but not together, and settings beyond their [bounds](#bounds).

An editor with a YAML language server completes and checks the keys when the first line names the schema
(`config/schema` of a checkout, `share/rigctl/config/schema` of an installation):

```text
# yaml-language-server: $schema=schema/rig.schema.json
# yaml-language-server: $schema=../schema/scenario.schema.json
```
"""
_BOUNDS = (
    ("minimum", "from {}"), ("exclusiveMinimum", "above {}"), ("maximum", "to {}"), ("exclusiveMaximum", "below {}"),
    ("minLength", "at least {} characters"), ("maxLength", "at most {} characters"), ("pattern", "matches `{}`"),
    ("minItems", "at least {}"), ("maxItems", "at most {}"),
)  # fmt: skip
_WORDS = {
    "number": "number", "integer": "integer", "string": "text", "boolean": "true, false", "null": "null",
    "object": "mapping", "array": "list",
}  # fmt: skip


def rig_schema() -> Node:
    """JSON Schema of the rig file."""
    schema = RigSettings.model_json_schema()
    for name in ADDED:
        del schema["properties"][name]
    schema["required"] = [name for name in schema["required"] if name not in ADDED]
    return _finished(schema, "rigctl rig file")


def scenario_schema() -> Node:
    """JSON Schema of the scenario file."""
    return _finished(Scenario.model_json_schema(), "rigctl scenario file")


def documents() -> dict[str, str]:
    """Every generated file, by its path below the root."""
    rig, scenario = rig_schema(), scenario_schema()
    limits = bounds.section(rig_file.load(rig_file.shipped("paper_rig.yaml")))
    page = [_HEAD, limits, "## Rig file\n", *_sections(rig, rig, ""), "## Scenario file\n",
            *_sections(scenario, scenario, "")]  # fmt: skip
    return {
        "config/schema/rig.schema.json": json.dumps(rig, indent=2) + "\n",
        "config/schema/scenario.schema.json": json.dumps(scenario, indent=2) + "\n",
        PAGE: "\n".join(page).rstrip("\n") + "\n",
    }


def _finished(schema: Node, title: str) -> Node:
    used = json.dumps(schema["properties"])
    while True:  # leave out what only the keys that are no keys of the file use
        kept = {name: node for name, node in schema["$defs"].items() if f'#/$defs/{name}"' in used}
        deeper = json.dumps([schema["properties"], kept])
        if deeper == used:
            break
        used = deeper
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "$defs": kept, "title": title}


def _sections(schema: Node, model: Node, path: str) -> list[str]:
    """The table of a section's keys, then those of the sections in it."""
    rows, inner = ["| key | value | default | meaning |", "|---|---|---|---|"], []
    required = model.get("required", [])
    for name, node in model.get("properties", {}).items():
        parts = [(words, found) for words, found in _models(schema, node)]
        default = "" if name in required else f"`{json.dumps(node.get('default'))}`" if "default" in node else "empty"
        place = f"{path}{name}"
        meaning = node.get("description", "") or "; ".join(found.get("description", "") for _, found in parts[:1])
        rows.append(f"| `{name}` | {_value(schema, node)} | {default} | {_cell(meaning)} |")
        for words, found in parts:
            inner += [f"### `{place}`{words}\n", _cell(found.get("description", "")).replace("\\|", "|") + "\n"]
            inner += _sections(schema, found, f"{place}.")
    return [*rows, "", *inner]


def _models(schema: Node, node: Node) -> list[tuple[str, Node]]:
    """Sections in a key's value, each with the words that tell it from the others."""
    found: list[tuple[str, Node]] = []
    if "$ref" in node:
        target = schema["$defs"][node["$ref"].rpartition("/")[2]]
        if "properties" in target:
            kind = target["properties"].get("kind", {}).get("const")
            found.append((f", kind {kind}" if kind else "", target))
    for choice in [*node.get("anyOf", []), *node.get("oneOf", []), *node.get("allOf", [])]:
        found += _models(schema, choice)
    for words, inner in (("items", ", each"), ("additionalProperties", ", each")):
        if isinstance(node.get(words), dict):
            found += [(f"{inner}{kind}", model) for kind, model in _models(schema, node[words])]
    for pattern in node.get("patternProperties", {}).values():
        found += [(", each", model) for _, model in _models(schema, pattern)]
    return found


def _value(schema: Node, node: Node) -> str:
    """What may stand there, in words."""
    if "$ref" in node:
        target = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return "section" if "properties" in target else _value(schema, target)
    if choices := [*node.get("anyOf", []), *node.get("oneOf", [])]:
        return ", or ".join(dict.fromkeys(_value(schema, choice) for choice in choices))
    if "const" in node:
        return f"`{json.dumps(node['const'])}`"
    if "enum" in node:
        return ", ".join(f"`{value}`" for value in node["enum"])
    words = [_WORDS.get(str(node.get("type")), "any value")]
    if isinstance(node.get("items"), dict):
        words = [f"list of {_value(schema, node['items'])}"]
    words += [text.format(_cell(str(node[key]))) for key, text in _BOUNDS if key in node]
    return " ".join(words)


def _cell(text: str) -> str:
    return " ".join(text.replace("``", "`").split()).replace("|", "\\|")


def write(root: pathlib.Path) -> None:
    """Write every generated file.

    Raises:
        OSError: one cannot be written.
    """
    for name, text in documents().items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


if __name__ == "__main__":
    write(pathlib.Path(sys.argv[1]))
