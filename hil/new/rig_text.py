"""The text of a rig file: the paper's, with other values in their lines. What is not changed keeps its comment."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hil.new.rig_sizing import Sized
from rigctl.config import strict_yaml

MODELINE = "# yaml-language-server: $schema=schema/rig.schema.json"
_COMMENT_AT = 33  # column of the comments, as in the paper's rig file


def with_head(text: str, head: Sequence[str]) -> str:
    """The text with other comments at its beginning."""
    lines = text.splitlines()
    body = next(at for at, line in enumerate(lines) if line and not line.startswith("#"))
    return "\n".join([*head, *lines[body:]]) + "\n"


def with_values(text: str, changes: Sequence[Sized]) -> str:
    """The text with other values; a value that is the same already keeps its line as it is.

    Raises:
        KeyError: the text has no such key.
    """
    document = strict_yaml.load(text)
    lines = text.splitlines()
    for change in changes:
        if change.path not in document.lines:
            raise KeyError(strict_yaml.dotted(change.path))
        if _found(document.data, change.path) != change.value:
            at = document.lines[change.path] - 1
            lines[at] = _line(lines[at], change)
    return "\n".join(lines) + "\n"


def _found(data: object, path: strict_yaml.Path) -> object:
    for part in path:
        data = data[part]  # type: ignore[index]
    return data


def _line(line: str, change: Sized) -> str:
    setting, hash_, comment = line.partition("#")
    key = re.escape(str(change.path[-1]))
    new, count = re.subn(rf"(?<!\w)({key}: *)[^,}}\s]+", rf"\g<1>{change.value}", setting.rstrip(), count=1)
    if count != 1:
        raise KeyError(strict_yaml.dotted(change.path))
    kept = comment.strip() if change.comment is None and hash_ else change.comment
    return f"{new:<{_COMMENT_AT - 2}} # {kept}" if kept else new
