"""Path of the repository."""

from __future__ import annotations

import pathlib

ROOT = pathlib.Path(__file__).parents[2]
