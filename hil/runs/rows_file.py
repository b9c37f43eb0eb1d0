"""Results of a long study in a file, a line of JSON each, so that a study that was stopped goes on where it was."""

from __future__ import annotations

import json
import pathlib
from typing import Any

from hil.scenario.errors import ScenarioError
from rigctl.ipc import output_file


class RowsFile:
    """Rows by key. The first line names what the study is of: rows of another rig file or seed are refused."""

    def __init__(self, file: pathlib.Path | None, study: dict[str, Any]) -> None:
        """``file``: None keeps the rows in memory only.

        Raises:
            ScenarioError: the file holds something else.
            OutputError: it cannot be written.
        """
        self._file, self._rows = file, dict[str, Any]()
        if file is None:
            return
        if not file.exists() or not file.stat().st_size:
            output_file.write(file, json.dumps({"study": study}) + "\n")
            return
        found, self._rows = read(file)
        if found != json.loads(json.dumps(study)):
            different = next((name for name in study if found.get(name) != study[name]), "study")
            raise ScenarioError([f"{file}: its rows are of another study ({different} differs), expected a new file"])

    def get(self, key: str) -> Any:
        """The row of a key; None if it has not been made."""
        return self._rows.get(key)

    def put(self, key: str, value: Any) -> Any:
        """Keep a row, on disk at once; returns it."""
        self._rows[key] = value
        if self._file is not None:
            with self._file.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps({"key": key, "value": value}, allow_nan=False) + "\n")
        return value


def read(file: pathlib.Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the rows of a file are of, and the rows by key.

    Raises:
        ScenarioError: it cannot be read, or holds something else.
    """
    try:
        first, *rows = (json.loads(line) for line in file.read_text(encoding="utf-8").splitlines())
        return dict(first["study"]), {row["key"]: row["value"] for row in rows}
    except (OSError, ValueError, KeyError, TypeError):
        raise ScenarioError([f"{file}: found no rows of a study, expected a new file or one of this study"]) from None
