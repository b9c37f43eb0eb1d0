"""What is wrong with a rig file, in words: ``FILE:LINE: key: found X, allowed Y``, from pydantic's errors."""

from __future__ import annotations

import difflib
import pathlib
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from rigctl import strict_yaml

Path = strict_yaml.Path

_UNITS = {
    "_n_s_mm": "N s/mm", "_n_s_m": "N s/m", "_n_mm": "N/mm", "_mm_s2": "mm/s2", "_deg_s2": "deg/s2", "_mm_s": "mm/s",
    "_deg_s": "deg/s", "_n_s": "N/s", "_bit_s": "bit/s", "_hz": "Hz", "_us": "us", "_ms": "ms", "_mm": "mm",
    "_kg": "kg", "_deg": "deg", "_pct": "%", "_n": "N", "_s": "s",
}  # fmt: skip


def unit_of(name: str) -> str:
    """Unit a key's name ends in, or an empty string."""
    return next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")


def section_type(info: FieldInfo) -> type[BaseModel] | None:
    """The section a field holds, or None for a value."""
    for candidate in (info.annotation, *getattr(info.annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def allowed(name: str, info: FieldInfo) -> str:
    """What the field ``name`` accepts, in words."""
    if section_type(info):
        return "a section (a mapping of keys)"
    kinds = {"int": "a whole number", "float": "a number", "str": "text", "bool": "true or false"}
    options = {getattr(a, "__name__", "") for a in (info.annotation, *getattr(info.annotation, "__args__", ()))}
    bounds: dict[str, Any] = {}
    for item in info.metadata:
        for bound in ("ge", "gt", "le", "lt", "pattern", "min_length", "max_length"):
            if getattr(item, bound, None) is not None:
                bounds[bound] = getattr(item, bound)
    unit = unit_of(name)
    text = next((text for kind, text in kinds.items() if kind in options), "") + (f" in {unit}" if unit else "")
    low = f"{bounds['ge']}" if "ge" in bounds else f"above {bounds['gt']}" if "gt" in bounds else ""
    if low:
        text += f", {low} to {bounds['le']}" if "le" in bounds else f", at least {low}"
    if "pattern" in bounds:
        text += f" matching {bounds['pattern']}"
    if "min_length" in bounds:
        text += f" of at least {bounds['min_length']} characters"
    return text + (", or null" if "NoneType" in options else "")


class Wording:
    """Words the errors of one document against the model it should have been."""

    def __init__(
        self, root: type[BaseModel], hidden: frozenset[str], document: strict_yaml.Document, file: pathlib.Path
    ) -> None:
        """``hidden``: fields of ``root`` that are not keys of the file."""
        self._root, self._hidden, self._document, self._file = root, hidden, document, file

    def lines(self, error: ValidationError) -> list[str]:
        """One line per error; a key that is missing because it is misspelt is reported once, as misspelt."""
        errors: list[Mapping[str, Any]] = [dict(e) for e in error.errors()]
        misspelt = {
            (*e["loc"][:-1], close)
            for e in errors
            if e["type"] == "extra_forbidden" and (close := self._close_key(e["loc"]))
        }
        return [self._line(e) for e in errors if e["type"] != "missing" or tuple(e["loc"]) not in misspelt]

    def _field(self, path: Path) -> FieldInfo | None:
        info: FieldInfo | None = None
        model: type[BaseModel] | None = self._root
        for part in path:
            fields = model.model_fields if model else {}
            if part not in fields:
                return None
            info = fields[str(part)]
            model = section_type(info)
        return info

    def _known_keys(self, path: Path) -> list[str]:
        section = self._field(path)
        model = section_type(section) if section else self._root
        return sorted(set(model.model_fields if model else {}) - self._hidden)

    def _close_key(self, path: Path) -> str | None:
        close = difflib.get_close_matches(str(path[-1]), self._known_keys(path[:-1]), n=1, cutoff=0.5)
        return close[0] if close else None

    def _allowed(self, path: Path) -> str:
        info = self._field(path)
        return allowed(str(path[-1]), info) if info else "no such key"

    def _line(self, error: Mapping[str, Any]) -> str:
        path: Path = tuple(error["loc"])
        context = error.get("ctx", {})
        found = "a section" if isinstance(error["input"], dict) else repr(error["input"])
        match error["type"]:
            case "extra_forbidden":
                close = self._close_key(path)
                words = f"{close}?" if close else ", ".join(self._known_keys(path[:-1]))
                return self._say(path, "an unknown key", words)
            case "missing":
                return self._say(path, "nothing", self._allowed(path))
            case "disagree":
                return self._say((*path, *context["key"].split(".")), context["found"], context["allowed"])
            case _:
                return self._say(path, found, self._allowed(path))

    def _say(self, path: Path, found: object, words: str) -> str:
        key = strict_yaml.dotted(path) or "file"
        return f"{self._file}:{self._document.line_of(path)}: {key}: found {found}, allowed {words}"
