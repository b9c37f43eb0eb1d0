"""The report as one self-contained HTML page: template, tables, charts."""

from __future__ import annotations

import base64
import pathlib

import jinja2

from rigctl import __version__
from rigctl.metrics.phases import SETTLE_S
from rigctl.report import charts, error_charts, tables
from rigctl.report.drawing import Chart, style
from rigctl.report.findings import ADVICE, Findings
from rigctl.report.sensor_budget import combined_n
from rigctl.report.verdict import REQUIREMENT_PCT

TEMPLATE = pathlib.Path(__file__).with_name("template")
BLANK = "_" * 24
EVENTS_OPEN = 60
"""A longer table of events is collapsed."""


def render(found: Findings, article: str = "", test: str = "") -> str:
    """The page. The same recording gives the same text, byte for byte.

    ``article``, ``test``: of the first box; without words a line to fill in.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATE), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["image"] = _image
    recording = found.recording
    return environment.get_template("report.html").render(
        found=found,
        recording=recording,
        article=article,
        test=test,
        blank=BLANK,
        version=__version__,
        charts=_charts(found),
        tables=tables,
        advice=ADVICE,
        settle_s=SETTLE_S,
        requirement_pct=REQUIREMENT_PCT,
        events_open=EVENTS_OPEN,
        duration_s=(recording.end_ns - recording.start_ns) * 1e-9,
        budget_n=combined_n(found.budget) if found.budget else None,
        gap_rows=[
            (gap.ring, gap.count, found.utc(gap.t_ns) if gap.t_ns else "the beginning") for gap in recording.gaps
        ],
    )


def overview(found: Findings) -> str:
    """The picture of the whole run, as SVG."""
    with style():
        return charts.overview(found).svg


def _charts(found: Findings) -> dict[str, Chart]:
    """Charts by name; those of a judged phase only if there is one."""
    with style():
        drawn: dict[str, Chart | None] = {"overview": charts.overview(found)}
        if not found.timing.simulated:
            drawn["lateness"] = error_charts.lateness(found)
        if (phase := found.shown) is not None:
            drawn |= {
                "figure_9": charts.figure_9(found, phase),
                "error": error_charts.error(found, phase),
                "histogram": error_charts.histogram(found),
                "spectrum": error_charts.spectrum(found),
                "inclination": charts.inclination(found, phase),
                "motion": charts.motion(found, phase),
            }
    return {name: chart for name, chart in drawn.items() if chart is not None}


def _image(chart: Chart) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(chart.svg.encode()).decode()
