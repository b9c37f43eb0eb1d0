"""The documentation against the code: commands parse, links resolve, paths and names exist, settings validate.

Python blocks are run by ``tests/live/telemetry/test_readme.py`` and ``tests/live/hil/test_docs_examples.py``.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import json
import pathlib
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import typer
import yaml
from PIL import Image

from hil.__main__ import app as hil_app
from rigctl.cli import typer_app
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.modes import TRANSITIONS
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model import fault_page
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.wire import fault_card
from tests import page_parts
from tests.builders.paths import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
ARCHITECTURE = ROOT / "docs/architecture.md"
KINDS = frozenset({
    "python",  # run against a live gateway
    "python test",  # run by pytest, on a rig in lockstep
    "python live",  # run by pytest, on a daemon of its own
    "python recording",  # run beside a recording
    "python serve",  # run beside a served rig
    "console",  # `$ ` and a command; every other line is output of it
    "text",  # a picture, or the form of a command
    "yaml",  # a whole file
    "yaml rig",  # sections of a rig file, to lay over config/paper_rig.yaml
    "json",
    "mermaid",
})  # fmt: skip
PROGRAMS = frozenset({"rigctl", "python", "make", "ip", "apt", "systemctl", ".venv/bin/python"})
"""Words that a command in a block may begin with."""
README_LINES = 80
"""Two screens."""
START_WORDS = 2500
CARD_WORDS = 1000
"""Two printed pages."""
ALL_WORDS = 35_000
"""Of README and docs/ without the decisions and the rows of generated tables."""
DOORS = {"operate": "operate.md", "install": "install.md", "develop": "architecture.md"}
GENERATED = {"modes.md", "fault-list.md", "fault-card.md", "rig-file.md", "mutation.md"}
"""Pages whose tables a command writes; of docs/faults.md it is the catalogue's."""
PLAIN = re.compile(
    r"\b(anew|ours|nobody|stands|judged|judges?|heard|learnt|knows|believed|believes|witness|rivals?|obeys?|he|his|him"
    r"|untold|asked)\b"
)
"""Words that are replaced by the field's noun. ``ours`` in code is the name of a law."""
PICTURE_BYTES = 150_000
GROUPS: dict[str, Any] = {"rigctl": typer.main.get_command(typer_app.program()), "hil": typer.main.get_group(hil_app)}
PATH = re.compile(r"(?:rigctl|hil|tests|config|docs)(?:/[\w.-]+)+/?|(?:rigctl|hil|tests|config|docs)/")
NAME = re.compile(r"((?:rigctl|hil|tests)(?:\.[A-Za-z_]\w*)+)(?:\(.*\))?")


@dataclass(frozen=True)
class Block:
    """A fenced block; ``where``: page and line."""

    where: str
    info: str
    text: str


def name_of(page: pathlib.Path) -> str:
    return str(page.relative_to(ROOT))


def split(page: pathlib.Path) -> tuple[list[Block], str]:
    """The fenced blocks of a page, and its text without them."""
    blocks: list[Block] = []
    prose: list[str] = []
    inside: list[str] | None = None
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if not line.startswith("```"):
            (prose if inside is None else inside).append(line)
        elif inside is None:
            where, info, inside = f"{name_of(page)}:{number}", line[3:].strip(), []
        else:
            assert line == "```", f"{name_of(page)}:{number}: a block ends in ```, found {line}"
            blocks.append(Block(where, info, "".join(f"{one}\n" for one in inside)))
            inside = None
    assert inside is None, f"{where}: the block has no end"
    return blocks, "\n".join(prose)


BLOCKS = [block for page in PAGES for block in split(page)[0]]


def code_spans(page: pathlib.Path) -> list[str]:
    """The text between single backticks, outside blocks, on one line each."""
    prose = re.sub(r"``.*?``", "", split(page)[1])
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]


# -- blocks ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.where)
def test_every_block_says_what_it_is(block: Block) -> None:
    assert block.info in KINDS, f"{block.where}: found ```{block.info}, expected one of {', '.join(sorted(KINDS))}"


def merged(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    both = {
        key: merged(under[key], value) if isinstance(under.get(key), dict) and isinstance(value, dict) else value
        for key, value in over.items()
    }
    return {**under, **both}


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.info.startswith("yaml")], ids=lambda block: block.where)
def test_settings_validate(block: Block) -> None:
    shown = yaml.safe_load(block.text)
    if block.info == "yaml rig":
        paper = yaml.safe_load((ROOT / "config/paper_rig.yaml").read_text())
        assert shown.keys() <= RigSettings.model_fields.keys()
        RigSettings.model_validate({**merged(paper, shown), "directory": str(ROOT / "config")})


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.info == "json"], ids=lambda block: block.where)
def test_json_is_json(block: Block) -> None:
    json.loads(block.text)


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.info.startswith("python")], ids=lambda block: block.where)
def test_python_is_python(block: Block) -> None:
    ast.parse(block.text)


# -- commands -------------------------------------------------------------------------------------------------------
class ReachedTheParserError(Exception):
    """Raised where the program parses its command line."""

    def __init__(self, parser: argparse.ArgumentParser, words: list[str]) -> None:
        super().__init__(parser.prog)
        self.parser, self.words = parser, words


def parser_of(module: str, words: list[str], monkeypatch: pytest.MonkeyPatch) -> ReachedTheParserError:
    """The parser that ``python -m MODULE WORDS`` makes, stopped there."""

    def reached(self: argparse.ArgumentParser, args: list[str] | None = None, _into: object = None) -> None:
        raise ReachedTheParserError(self, sys.argv[1:] if args is None else list(args))

    with monkeypatch.context() as patch, pytest.raises(ReachedTheParserError) as stopped:
        patch.setattr(argparse.ArgumentParser, "parse_args", reached)
        patch.setattr(sys, "argv", [module, *words])
        try:
            runpy.run_module(module, run_name="__main__")
        except ModuleNotFoundError as error:  # of an optional group of pyproject.toml
            pytest.skip(str(error))
    return stopped.value


def options_of(words: list[str]) -> list[str]:
    return [word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)]


def check_typer(program: str, words: list[str], *, whole: bool) -> None:
    group = GROUPS[program]
    if not words or words[0].startswith("-"):
        assert {*options_of(words)} <= {opt for param in group.params for opt in param.opts} | {"-h", "--help"}
        return
    command = group.commands.get(words[0])
    assert command is not None, f"{program} has no command {words[0]}"
    known = {option for param in command.params for option in (*param.opts, *param.secondary_opts)}
    assert {*options_of(words)} <= known | {"-h", "--help"}, f"{program} {words[0]} has {', '.join(sorted(known))}"
    if whole:
        command.make_context(f"{program} {words[0]}", words[1:], **command.context_settings)


def check_module(module: str, words: list[str], monkeypatch: pytest.MonkeyPatch, *, whole: bool) -> None:
    if module == "hil":
        check_typer("hil", words, whole=whole)
    elif module == "pytest":
        for word in words:
            assert word.startswith("-") or (ROOT / word).exists(), f"{word} does not exist"
    elif module.startswith("tests."):
        found = parser_of(module, words, monkeypatch)
        assert {*options_of(words)} <= found.parser._option_string_actions.keys(), f"{module} has no such option"
        if whole:
            found.parser.parse_args(found.words)
    else:
        assert importlib.util.find_spec(module) is not None, f"there is no module {module}"


def targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def check_command(line: str, monkeypatch: pytest.MonkeyPatch, *, whole: bool) -> None:
    """Check that command, options and, if ``whole``, values are valid for the program itself."""
    words = shlex.split(line if whole else re.sub(r"[\[\]]|\.\.\.", "", line), comments=True)
    for end in (">", "|"):
        words = words[: words.index(end)] if end in words else words
    program, *rest = words
    if program == "rigctl":
        check_typer("rigctl", rest, whole=whole)
    elif program == "make":
        assert {*rest} <= targets(), f"the Makefile has {', '.join(sorted(targets()))}"
    elif program.endswith("python"):
        assert rest[0] == "-m", line
        check_module(rest[1], rest[2:], monkeypatch, whole=whole)
    else:
        assert program in PROGRAMS, f"found {program}, expected one of {', '.join(sorted(PROGRAMS))}"


def commands() -> Iterator[Any]:
    for block in BLOCKS:
        for number, line in enumerate(block.text.splitlines(), 1):
            if block.info == "console" and line.startswith("$ "):
                yield pytest.param(line[2:], True, id=f"{block.where}+{number}")
            elif block.info == "text" and re.match(r"rigctl [a-z]|python -m ", line):
                yield pytest.param(line, False, id=f"{block.where}+{number}")
    for page in PAGES:
        for span in dict.fromkeys(code_spans(page)):
            if re.match(r"rigctl [-a-z]|python -m (hil|tests|rigctl)\b|make [a-z]+$", span):
                yield pytest.param(span, False, id=f"{name_of(page)}: {span}")


@pytest.mark.parametrize(("line", "whole"), list(commands()))
def test_commands_are_those_of_the_programs(line: str, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    check_command(line, monkeypatch, whole=whole)


@pytest.mark.parametrize(
    "line", ["rigctl no-such-command", "rigctl arm --no-such-option", "rigctl target many", "make nothing",
             "python -m hil scenario", "python -m hil paper --no-such-option", "python -m tests.fuzz nothing"]
)  # fmt: skip
def test_a_command_that_is_none_is_noticed(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises((Exception, SystemExit, AssertionError)):
        check_command(line, monkeypatch, whole=True)


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.info == "console"], ids=lambda block: block.where)
def test_a_console_begins_with_a_command(block: Block) -> None:
    assert block.text.startswith("$ ")


# -- links, paths, names --------------------------------------------------------------------------------------------
def anchors(page: pathlib.Path) -> set[str]:
    """The anchors that GitHub makes of the headings."""
    headings = re.findall(r"^#+ (.*)$", split(page)[1], re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links() -> Iterator[Any]:
    for page in PAGES:
        for target in dict.fromkeys(re.findall(r"\]\(([^)\s]+)\)", split(page)[1])):
            if not target.startswith("http"):
                yield pytest.param(page, target, id=f"{name_of(page)}: {target}")


@pytest.mark.parametrize(("page", "target"), list(links()))
def test_links_lead_somewhere(page: pathlib.Path, target: str) -> None:
    file, _, anchor = target.partition("#")
    there = (page.parent / file).resolve() if file else page
    assert there.exists(), f"{target} does not exist"
    if anchor:
        assert anchor in anchors(there), f"{name_of(there)} has {', '.join(sorted(anchors(there)))}"
    if there.suffix == ".png":
        assert there.stat().st_size < PICTURE_BYTES


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_paths_exist(page: pathlib.Path) -> None:
    missing = [span for span in code_spans(page) if PATH.fullmatch(span) and not (ROOT / span).exists()]
    assert not missing


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or a name in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(found, part) and part not in getattr(found, "__annotations__", {}):
                return False
            found = getattr(found, part, None)
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_names_exist(page: pathlib.Path) -> None:
    names = {match[1] for span in code_spans(page) if (match := NAME.fullmatch(span))}
    assert not [name for name in names if not resolves(name)]


def defined_in(file: pathlib.Path) -> set[str]:
    kinds = ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef
    return {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, kinds)}


def test_functions_are_in_the_files_they_are_said_to_be_in() -> None:
    text = ARCHITECTURE.read_text()
    said = re.findall(r"`([\w.]+)`(?: \| |\s+(?:of|in)\s+)`([\w/]+\.py)`", text)
    assert len(said) > 40
    for name, file in said:
        assert {*name.split(".")} <= defined_in(ROOT / file), f"{file} has no {name}"


# -- promises of the pages ------------------------------------------------------------------------------------------
def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= README_LINES


def leads_to(page: pathlib.Path) -> set[pathlib.Path]:
    """Pages of docs/ that a page links."""
    found = {(page.parent / link).resolve() for link in re.findall(r"\]\(([\w./-]+\.md)", split(page)[1])}
    return {there for there in found if there.parent == ROOT / "docs"}


def test_the_readme_leads_to_every_page_through_a_door() -> None:
    doors = {ROOT / "docs" / page for page in DOORS.values()}
    readme = leads_to(ROOT / "README.md")
    assert doors <= readme
    behind = set().union(*map(leads_to, doors))
    assert readme | behind == {page for page in PAGES if page.parent != ROOT}


def prose(page: pathlib.Path) -> Iterator[str]:
    """Lines of a page without its blocks and the rows of generated tables."""
    catalogue = False
    for line in split(page)[1].splitlines():
        catalogue = line.startswith("|") and (catalogue or line.startswith("| id | place |"))
        if not catalogue and not (line.startswith("|") and page.name in GENERATED):
            yield line


def test_the_documentation_stays_short() -> None:
    counted = [ROOT / "README.md", *(page for page in ROOT.glob("docs/*.md") if page.name != "decisions.md")]
    by_page = {name_of(page): words("\n".join(prose(page))) for page in counted}
    assert sum(by_page.values()) <= ALL_WORDS, by_page
    assert by_page["docs/operate.md"] <= START_WORDS


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name not in ("decisions.md", "CHANGELOG.md")], ids=name_of
)
def test_words_are_the_fields(page: pathlib.Path) -> None:
    text = re.sub(r"`[^`]*`", "", "\n".join(prose(page)))
    assert not PLAIN.findall(text)


@pytest.mark.parametrize("parts", [page_parts.PARTS])
def test_the_start_page_names_every_numbered_part(parts: dict[str, tuple[int, int]]) -> None:
    page = (ROOT / "docs/operate.md").read_text()
    named = re.findall(r"^\| (\d+) ([^|]+?) \|", page, re.MULTILINE)
    assert [int(number) for number, _ in named] == list(range(1, len(parts) + 1))
    assert all(name.startswith(part) for (_, name), part in zip(named, parts, strict=True))
    folder = ROOT / "docs/pictures"
    with Image.open(folder / page_parts.OVER) as kept:
        kept_pixels = kept.convert("RGB").tobytes()
    assert kept_pixels == page_parts.drawn(folder / page_parts.UNDER).convert("RGB").tobytes(), (
        "run `python -m tests.page_parts docs/pictures`"
    )


def arrows(page: pathlib.Path) -> list[tuple[str, str, str]]:
    """From, to and words of the arrows in a page's pictures."""
    pictures = "".join(block.text for block in split(page)[0] if block.info == "mermaid")
    return re.findall(r"^ +(\w+) --> (\w+): (.+)$", pictures, re.MULTILINE)


def test_the_modes_of_the_start_page_are_those_of_the_table() -> None:
    changes = {(mode.name, transition.after.name) for (mode, _), transition in TRANSITIONS.items()}
    found = {(before, after) for before, after, _ in arrows(ROOT / "docs/operate.md")}
    assert found <= changes
    assert {name for pair in found for name in pair} == {mode.name for mode in Mode}


def test_the_processes_are_drawn_with_every_ring() -> None:
    table = re.findall(r"^\| `(\w+)` \| (\w+) \|", ARCHITECTURE.read_text(), re.MULTILINE)
    rings = {name: writer for name, writer in table if writer in ("control", "gateway", "supervisor")}
    drawn = {(ring, before) for before, _, said in arrows(ARCHITECTURE) for ring in said.split(", ") if ring in rings}
    assert drawn == set(rings.items())


def layers() -> dict[str, list[str]]:
    """The table of allowed imports."""
    table = ARCHITECTURE.read_text().partition("| folder | may import |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = [re.findall(r"`([^`]+)`", line) for line in table.splitlines()]
    assert len({row[0] for row in rows}) == len(rows)
    return {row[0]: row[1:] for row in rows}


def test_the_table_of_layers_has_every_folder() -> None:
    folders = {name_of(init.parent) for root in ("rigctl", "hil") for init in (ROOT / root).glob("*/__init__.py")}
    loose = {name_of(file) for file in (ROOT / "hil").glob("*.py")} - {"hil/__init__.py"}
    assert set(layers()) == folders | loose


def test_the_table_of_layers_goes_down() -> None:
    """Each row imports only rows that do not lead back to it."""
    table, done = layers(), set[str]()
    while len(done) < len(table):
        next_ = {folder for folder, below in table.items() if {*below} <= done}
        assert next_ - done, f"a circle among {', '.join(sorted(table.keys() - done))}"
        done |= next_


def test_every_command_is_documented() -> None:
    spans = [span for page in PAGES for span in code_spans(page)]
    lines = [line[2:] for block in BLOCKS if block.info == "console" for line in block.text.splitlines()]
    text = "\n".join([*spans, *lines, *(block.text for block in BLOCKS if block.info == "text")])
    for program, group in {"rigctl": GROUPS["rigctl"], "python -m hil": GROUPS["hil"]}.items():
        missing = [name for name in group.commands if not re.search(rf"^{program} {name}\b", text, re.MULTILINE)]
        assert not missing, program


def test_the_architecture_names_every_ring(tmp_path: pathlib.Path) -> None:
    Runtime(tmp_path).make_rings(config.load(ROOT / "config/paper_rig.yaml"))
    table = ARCHITECTURE.read_text().partition("| ring | written by | slot |\n|---|---|---|\n")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) == sorted(file.name for file in tmp_path.iterdir())


def test_the_operator_reads_about_every_fault() -> None:
    page = (ROOT / "docs/fault-list.md").read_text()
    assert page == fault_page.document(), "run `python -m rigctl.model.fault_page > docs/fault-list.md`"
    rows = re.findall(r"^\| `([A-Z_]+)` \| \S.* \| \S.* \|$", page, re.MULTILINE)
    assert sorted(rows) == sorted(fault.name for fault in Fault if fault is not Fault.NONE)


def test_the_fault_card_is_that_of_the_catalogue_and_fits_two_pages() -> None:
    card = (ROOT / "docs/fault-card.md").read_text()
    assert card == fault_card.document(), "run `python -m rigctl.wire.fault_card > docs/fault-card.md`"
    assert words(card) <= CARD_WORDS
    for row in fault_card.SITUATIONS:
        assert (row.shows or row.causes) and (row.then or row.causes) and row.first and row.entry and row.call


def words(text: str) -> int:
    """Words as `wc -w` counts them, of those that have a letter or a digit."""
    return sum(bool(re.search(r"\w", word)) for word in text.split())


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.info == "mermaid"], ids=lambda block: block.where)
def test_an_arrow_has_no_sign_that_ends_its_words(block: Block) -> None:
    """Mermaid ends the words of an arrow at a colon and at a semicolon."""
    for line in block.text.splitlines():
        assert not re.search("[:;]", line.partition(": ")[2]), f"{block.where}: {line}"


def test_the_roles_and_the_keys_have_every_command() -> None:
    """Each cell of the table of roles is tried by ``tests/live/telemetry/test_roles.py``."""
    names = [verb.name.lower() for verb in Verb]
    roles, keys = ((ROOT / "docs" / page).read_text() for page in ("security.md", "telemetry.md"))
    assert not [name for name in names if f"`cmd/NAME/{name}`" not in roles]
    (listed,) = re.findall(r"^\| `cmd/<verb>` \| .*`([a-z_ ]+)`", keys, re.MULTILINE)
    assert sorted(listed.split()) == sorted(names)


def test_the_glossary_has_a_line_for_each_term() -> None:
    rows = [line for line in (ROOT / "docs/glossary.md").read_text().splitlines() if line.startswith("| ")]
    terms = [row.split(" | ")[0] for row in rows if row != "| term | meaning |"]
    assert all(len(row.split(" | ")) == 2 for row in rows)
    assert len(set(terms)) == len(terms)
    assert len(terms) > 150


def test_decisions_are_numbered_and_have_a_reason() -> None:
    text = (ROOT / "docs/decisions.md").read_text()
    numbers = [int(number) for number in re.findall(r"^(\d+)\. \*\*", text, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
