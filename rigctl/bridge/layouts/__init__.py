"""Layouts of other tools for this rig, as files: what to plot, with which unit, beside what."""

from __future__ import annotations

import pathlib

FOXGLOVE, PLOTJUGGLER, GRAFANA = "foxglove.json", "plotjuggler.xml", "grafana.json"


def text_of(name: str) -> str:
    """The text of a layout's file."""
    return (pathlib.Path(__file__).parent / name).read_text(encoding="utf-8")
