"""YAML read without YAML 1.1's surprises: every value keeps its line, and no type is guessed.

PyYAML reads ``1e-3`` as a string, ``010`` as 8, ``12:30`` as 750, ``on`` as true and takes a duplicate key
silently. Here each of these is refused with the line it stands on, so that a rig file means what it says.
"""

from __future__ import annotations

import functools
import pathlib
import re
from dataclasses import dataclass
from typing import Any

import yaml

from rigctl.config.one_line import on_one_line

Path = tuple[str | int, ...]

_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)\Z")
_FLOAT = re.compile(r"[-+]?(0|[1-9][0-9]*)\.[0-9]+([eE][-+][0-9]+)?\Z")
_ADDRESS = re.compile(r"[0-9]{1,3}(\.[0-9]{1,3}){3}\Z")  # of IPv4: no YAML reads it as a number
_NUMBER_LIKE = re.compile(r"[-+]?(\.?[0-9]|\.(inf|nan)\b)|(nan|inf)\Z", re.IGNORECASE)
_BARE_NUMBER = re.compile(r"[-+.0-9eExXoObB_:a-fA-F]*\Z")
LONGEST_NUMBER = 40
LARGEST_BYTES = 200_000
"""Of a file: twenty times the longest we ship. A larger file is no settings file and takes seconds to read."""
MOST_VALUES = 20_000
"""Of a document, every alias written out: a few lines of aliases can stand for millions of values."""
_COLLECTIONS = frozenset({"tag:yaml.org,2002:map", "tag:yaml.org,2002:seq"})
_YAML_1_1_BOOL = frozenset({"yes", "no", "on", "off", "y", "n"})


class StrictYamlError(ValueError):
    """The text is not a document this loader accepts; ``line`` is 1-based."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line
        self.message = message


class FileError(ValueError):
    """A file that holds no document this loader accepts; ``str()`` is one line that names it."""


@dataclass(frozen=True)
class Unreadable:
    """Placeholder in the data for a refused value, so that validation reports it together with other errors."""

    text: str
    allowed: str


@dataclass(frozen=True)
class Document:
    """A loaded document: plain data, and the 1-based line of each path.

    A value that may be read in two ways is an `Unreadable`, which no setting accepts.
    """

    data: Any
    lines: dict[Path, int]

    def line_of(self, path: Path) -> int:
        """Line of ``path``, or of the nearest parent that is in the file."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


def read(file: pathlib.Path) -> Document:
    """Read a file that holds one document, see `load`.

    Raises:
        FileError: as in `text_of`, or the file holds no such document.
    """
    try:
        return load(text_of(file))
    except StrictYamlError as error:
        raise FileError(f"{file}:{error.line}: {error.message}") from None


def text_of(file: pathlib.Path) -> str:
    """The text of a settings file.

    Raises:
        FileError: the file is unreadable, too large, or no UTF-8 text.
    """
    try:
        if file.exists() and not file.is_file() and not file.is_dir():  # reading a pipe may never end
            raise FileError(f"{file}: cannot be read: not a file")
        with file.open("rb") as opened:
            data = opened.read(LARGEST_BYTES + 1)
        if len(data) > LARGEST_BYTES:
            raise FileError(f"{file}: found more than {LARGEST_BYTES} bytes, expected a settings file")
        return data.decode()
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{file}: not UTF-8 text (byte {error.start})") from None


def load(text: str) -> Document:
    """Read one YAML document made of mappings, lists and plain scalars.

    Raises:
        StrictYamlError: it has the line and the expected form.
    """
    try:
        root = _composed(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise StrictYamlError(mark.line + 1 if mark else 1, f"not YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise StrictYamlError(1, f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise StrictYamlError(1, "nested too deeply") from None
    if root is None:
        raise StrictYamlError(1, "the file is empty")
    lines: dict[Path, int] = {}
    try:
        data = _value(root, (), lines)
    except RecursionError:
        raise StrictYamlError(1, "nested too deeply, or an alias refers to itself") from None
    if isinstance(data, Unreadable):
        raise StrictYamlError(lines[()], f"file: found {on_one_line(data.text)}, expected {data.allowed}")
    return Document(data, lines)


@functools.lru_cache(maxsize=4)
def _composed(text: str) -> yaml.Node | None:
    """The document's nodes, which are only read; a command may read its rig file several times, 20 ms each."""
    return yaml.compose(text, Loader=yaml.SafeLoader)


def _value(node: yaml.Node, path: Path, lines: dict[Path, int]) -> Any:
    lines.setdefault(path, node.start_mark.line + 1)
    if len(lines) > MOST_VALUES:
        line = node.start_mark.line + 1
        raise StrictYamlError(line, f"found more than {MOST_VALUES} values, expected a settings file")
    if not isinstance(node, yaml.ScalarNode) and node.tag not in _COLLECTIONS:
        where = dotted(path) or "file"
        raise StrictYamlError(node.start_mark.line + 1, f"{where}: found the tag {node.tag}, expected no tags")
    if isinstance(node, yaml.MappingNode):
        return _mapping(node, path, lines)
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, (*path, i), lines) for i, item in enumerate(node.value)]
    return _scalar(node, path)


def _mapping(node: yaml.MappingNode, path: Path, lines: dict[Path, int]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        key = key_node.value
        if not isinstance(key, str) or key_node.tag == "tag:yaml.org,2002:merge":
            raise StrictYamlError(line, f"{dotted(path) or 'file'}: a key must be a plain word")
        if key in result:
            first = lines[(*path, key)]
            raise StrictYamlError(
                line, f"{dotted((*path, key))}: found the key twice (first on line {first}), expected once"
            )
        lines[(*path, key)] = line
        result[key] = _value(value_node, (*path, key), lines)
    return result


def _scalar(node: yaml.Node, path: Path) -> Any:
    text: str = node.value
    line = node.start_mark.line + 1
    if isinstance(node, yaml.ScalarNode) and node.style is not None:
        return text
    if not node.tag.startswith("tag:yaml.org,2002:"):
        raise StrictYamlError(line, f"{dotted(path)}: found the tag {node.tag}, expected no tags")
    if text in ("", "null", "~"):
        return None
    if text in ("true", "false"):
        return text == "true"
    if text.lower() in _YAML_1_1_BOOL:
        return Unreadable(text, "true or false (or quotes for text)")
    if _INT.match(text) and len(text) <= LONGEST_NUMBER:
        return int(text)
    if _FLOAT.match(text):
        return float(text)
    if _ADDRESS.match(text):
        return text
    if _NUMBER_LIKE.match(text) and (_BARE_NUMBER.match(text) or text.lower().lstrip("+-.") in ("inf", "nan")):
        return Unreadable(text, "a finite number written like 10, 0.001 or 1.0e-3")
    return text


def dotted(path: Path) -> str:
    """``("loop", "rate_hz")`` as ``loop.rate_hz``."""
    return ".".join(str(part) for part in path)
