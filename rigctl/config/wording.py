"""Errors of a settings file in words, ``FILE:LINE: key: found X, expected Y``, from pydantic's errors."""

from __future__ import annotations

import difflib
import pathlib
import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from rigctl.config import strict_yaml
from rigctl.config.one_line import on_one_line
from rigctl.model.quantity import unit_of

Path = strict_yaml.Path
_KINDS = {int: "a whole number", float: "a number", str: "text", bool: "true or false"}
_SECTION = "a section (a mapping of keys)"


class KeyType(NamedTuple):
    """Schema of one place in a file: a type and its constraints."""

    annotation: Any
    constraints: tuple[Any, ...] = ()

    @classmethod
    def of(cls, info: FieldInfo) -> KeyType:
        """The type of a field."""
        return cls(info.annotation, tuple(info.metadata))._bare()

    @property
    def choices(self) -> tuple[Any, ...]:
        """The allowed types, without null."""
        union = get_origin(self.annotation) in (Union, types.UnionType)
        return tuple(a for a in get_args(self.annotation) if a is not type(None)) if union else (self.annotation,)

    @property
    def optional(self) -> bool:
        """Null is allowed."""
        return type(None) in get_args(self.annotation)

    @property
    def model(self) -> type[BaseModel] | None:
        """The section's model; None for a value, a list or a choice of sections."""
        only = self.choices[0] if len(self.choices) == 1 else None
        return only if isinstance(only, type) and issubclass(only, BaseModel) else None

    @property
    def kinds(self) -> dict[str, type[BaseModel]]:
        """Sections to choose from by their ``kind``; empty for anything else."""
        found: dict[str, type[BaseModel]] = {}
        for choice in self.choices:
            kind = (
                choice.model_fields.get("kind") if isinstance(choice, type) and issubclass(choice, BaseModel) else None
            )
            if kind is not None:
                found |= dict.fromkeys(get_args(kind.annotation), choice)
        return found

    def child(self, part: str | int) -> KeyType | None:
        """The type at ``part`` within this one; None where none is allowed."""
        if self.model is not None:
            info = self.model.model_fields.get(str(part))
            return KeyType.of(info) if info else None
        for choice in self.choices:
            origin, arguments = get_origin(choice), get_args(choice)
            if origin is list and isinstance(part, int):
                return KeyType(arguments[0])._bare()
            if origin is dict and isinstance(part, str):
                return KeyType(arguments[1])._bare()
        return None

    def key(self) -> KeyType | None:
        """The type of its keys, where the user chooses them."""
        names = [get_args(choice)[0] for choice in self.choices if get_origin(choice) is dict]
        return KeyType(names[0])._bare() if names else None

    def allowed(self, name: str = "") -> str:
        """Accepted values in words; ``name`` gives the unit."""
        text = self._what(unit_of(name)) + self._bounds()
        return text + (", or null" if self.optional else "")

    def _what(self, unit: str) -> str:
        if self.kinds:
            return f"{_SECTION} with kind {_either(list(self.kinds))}"
        choice = self.choices[0]
        origin = get_origin(choice)
        if self.model is not None or origin is dict:
            return _SECTION
        if origin is list:
            inner = KeyType(get_args(choice)[0])._bare()
            what = "sections" if inner.model or inner.kinds else {float: "numbers"}.get(inner.annotation, "text")
            return f"a list of {what}"
        if origin is Literal:
            return _either(list(get_args(choice)))
        return _KINDS.get(choice, "") + (f" in {unit}" if unit else "")

    def _bounds(self) -> str:
        bounds: dict[str, Any] = {}
        for item in self.constraints:
            for bound in ("ge", "gt", "le", "lt", "pattern", "min_length", "max_length"):
                if getattr(item, bound, None) is not None:
                    bounds[bound] = getattr(item, bound)
        text = ""
        low = f"{bounds['ge']}" if "ge" in bounds else f"above {bounds['gt']}" if "gt" in bounds else ""
        if low:
            text += (
                f", {low} to {bounds['le']}"
                if "le" in bounds
                else f", at least {low}"
                if "ge" in bounds
                else f", {low}"
            )
        if "pattern" in bounds:
            text += f" matching {bounds['pattern']}"
        if "min_length" in bounds:
            unit = "characters" if self.choices[0] is str else "items"
            most = f"{bounds['min_length']} to {bounds['max_length']}" if "max_length" in bounds else ""
            text += f" of {most or 'at least ' + str(bounds['min_length'])} {unit}"
        return text

    def _bare(self) -> KeyType:
        """The type without ``Annotated``, whose arguments become constraints."""
        if get_origin(self.annotation) is not Annotated:
            return self
        inner, *more = get_args(self.annotation)
        found: list[Any] = list(self.constraints)
        for item in more:
            found += item.metadata if isinstance(item, FieldInfo) else [item]
        return KeyType(inner, tuple(found))


def key_of(path: Path) -> str:
    """A path for a finding, as ``loop.rate_hz``; always on one line."""
    return on_one_line(strict_yaml.dotted(path) or "file")


class Wording:
    """Words the errors of one document against its model."""

    def __init__(
        self, root: type[BaseModel], hidden: frozenset[str], document: strict_yaml.Document, file: pathlib.Path
    ) -> None:
        """``hidden``: fields of ``root`` that are not keys of the file."""
        self._root, self._hidden, self._document, self._file = root, hidden, document, file

    def lines(self, error: ValidationError) -> list[str]:
        """One line per error; a key that is missing because it is misspelt is reported once, as misspelt."""
        errors: list[Mapping[str, Any]] = _once(error)
        misspelt = {
            (*e["loc"][:-1], close)
            for e in errors
            if e["type"] == "extra_forbidden" and (close := self._close_key(e["loc"]))
        }
        return [self._line(e) for e in errors if e["type"] != "missing" or tuple(e["loc"]) not in misspelt]

    def place(self, path: Path) -> str:
        """File, line and key of ``path``: ``FILE:LINE: key``."""
        return f"{self._file}:{self._document.line_of(path)}: {key_of(path)}"

    def say(self, path: Path, found: object, words: str) -> str:
        """One finding: ``path`` holds ``found``; ``words`` give the allowed values."""
        return f"{self.place(path)}: found {on_one_line(str(found))}, expected {words}"

    def _resolve(self, loc: Path) -> tuple[Path, KeyType | None]:
        """Pydantic's place in the model as a path in the file, with its type.

        They differ where a section is one of several kinds: pydantic names the kind on the way.
        """
        path: list[str | int] = []
        kind: KeyType | None = KeyType(self._root)
        for part in loc:
            if kind is not None and part == "[key]":
                return tuple(path), kind
            if kind is not None and part in kind.kinds and kind.model is None:
                kind = KeyType(kind.kinds[str(part)])
                continue
            path.append(part)
            if kind is not None:
                kind = kind.key() if loc[len(path) :] == ("[key]",) else kind.child(part)
        return tuple(path), kind

    def _known_keys(self, loc: Path) -> list[str]:
        kind = self._resolve(loc)[1]
        return sorted(set(kind.model.model_fields if kind and kind.model else {}) - self._hidden)

    def _close_key(self, loc: Path) -> str | None:
        close = difflib.get_close_matches(str(loc[-1]), self._known_keys(loc[:-1]), n=1, cutoff=0.5)
        return close[0] if close else None

    def _line(self, error: Mapping[str, Any]) -> str:
        loc: Path = tuple(error["loc"])
        path, kind = self._resolve(loc)
        words = kind.allowed(str(path[-1]) if path else "") if kind else "no such key"
        context = error.get("ctx", {})
        if isinstance(value := error.get("input"), strict_yaml.Unreadable):
            return self.say(
                path, value.text, f"{words}, in quotes" if kind and kind.choices == (str,) else value.allowed
            )
        match error["type"]:
            case "extra_forbidden":
                close = self._close_key(loc)
                return self.say(path, "an unknown key", f"{close}?" if close else ", ".join(self._known_keys(loc[:-1])))
            case "missing":
                return self.say(path, "nothing", words)
            case "union_tag_not_found":
                return self.say((*path, "kind"), "nothing", _either(list(kind.kinds if kind else ())))
            case "union_tag_invalid":
                found = repr(error["input"]["kind"])
                return self.say((*path, "kind"), found, _either(list(kind.kinds if kind else ())))
            case "disagree":
                key = [int(part) if part.isdigit() else part for part in context["key"].split(".") if part]
                return self.say((*path, *key), context["found"], context["allowed"])
            case "string_type" if kind and isinstance(error["input"], int | float):
                return self.say(path, _shown(error["input"]), f"{words}, in quotes")
            case _:
                return self.say(path, _shown(error["input"]), words)


def _once(error: ValidationError) -> list[Mapping[str, Any]]:
    """The errors, with a single one for an unreadable value of several allowed types."""
    found: list[Mapping[str, Any]] = []
    unreadable: set[int] = set()
    for item in error.errors():
        value = item["input"]
        if isinstance(value, strict_yaml.Unreadable):
            if id(value) in unreadable:
                continue
            unreadable.add(id(value))
        found.append(dict(item))
    return found


def _shown(value: object) -> str:
    """A value for an error: in full if short."""
    return "a section" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)


def _either(options: list[Any]) -> str:
    """``a, b or c``."""
    words = [str(option) for option in options]
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
