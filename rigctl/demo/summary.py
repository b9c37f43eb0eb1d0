"""The demo's figures, compared with the limits in the rig file."""

from __future__ import annotations

import math
import pathlib
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import DemoSettings
from rigctl.metrics import tension_error as metrics
from rigctl.model.states import Mode

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Frames:
    """CAN frames of the loop."""

    sent: int
    received: int
    lost: int


@dataclass(frozen=True)
class Telemetry:
    """Samples on the fast stream, as counted by an independent subscriber."""

    produced: int
    received: int

    @property
    def lost(self) -> int:
        """Samples that did not reach the subscriber."""
        return self.produced - self.received


@dataclass(frozen=True)
class Summary:
    """The demo's figures; names are those of the JSON."""

    eta_true_max_pct: float
    eta_true_rms_pct: float
    eta_cell_max_pct: float
    skipped_ticks: int
    ticks: int
    lateness_us: dict[str, float] | None  # None in lockstep: no tick is late in simulated time
    work_us: dict[str, float] | None
    frames: Frames
    telemetry: Telemetry | None  # None in lockstep: there is no subscriber
    duration_s: float
    real_time: bool  # with processes of its own; False: in simulated time
    tripped: bool
    recording: str | None  # its first part; None without a recording
    passed: bool

    def as_dict(self) -> dict[str, Any]:
        """As JSON values; a missing figure is null."""
        values = asdict(self)
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def summarise(
    records: Array, truth: Array, telemetry: Telemetry | None, demo: DemoSettings, recording: pathlib.Path | None
) -> Summary:
    """Figures of the records of the whole demo, and of the truth over the same time.

    Args:
        records: ``record.RECORD`` slots.
        truth: a structured array with ``t_ns`` and ``vertical_n`` from the plant.
        telemetry: the subscriber's count; None in simulated time, which has no subscriber and no lateness.
        demo: the limits.
        recording: its file, if there is one.
    """
    spans = metrics.compensating_windows(records, demo.settle_s)
    target_n = float(records["target_n"][-1])
    true_max, true_rms = metrics.largest_and_rms_pct(
        truth["vertical_n"][metrics.within(truth["t_ns"], spans)], target_n
    )
    cell_max, _ = metrics.largest_and_rms_pct(records["vertical_n"][metrics.within(records["t_ns"], spans)], target_n)
    lost = int(np.min(records["frames_lost"][-metrics.IN_FLIGHT_TICKS :])) + int(records["send_failures"][-1])
    tripped = bool(np.any(records["mode"] == Mode.FAULT))
    passed = (
        true_max <= demo.eta_max_pct
        and true_rms <= demo.eta_rms_pct
        and lost <= demo.frames_lost_max
        and (telemetry is None or telemetry.lost <= demo.samples_lost_max)
        and not tripped
    )
    return Summary(
        eta_true_max_pct=true_max,
        eta_true_rms_pct=true_rms,
        eta_cell_max_pct=cell_max,
        skipped_ticks=int(records["skipped"][-1]),
        ticks=len(records),
        lateness_us=metrics.percentiles_us(records["lateness_ns"]) if telemetry else None,
        work_us=metrics.percentiles_us(records["work_ns"]) if telemetry else None,
        frames=Frames(int(records["frames_sent"][-1]), int(records["frames_received"][-1]), lost),
        telemetry=telemetry,
        duration_s=round(float(records["t_ns"][-1] - records["t_ns"][0]) * 1e-9, 1),
        real_time=telemetry is not None,
        tripped=tripped,
        recording=str(recording) if recording is not None else None,
        passed=passed,
    )


def rows(summary: Summary, demo: DemoSettings) -> list[tuple[str, str, str, bool | None]]:
    """Rows of the table: quantity, measured, limit, met (None: no limit)."""
    s = summary
    table: list[tuple[str, str, str, bool | None]] = [
        ("true vertical error, max", f"{s.eta_true_max_pct:.4f} %", f"{demo.eta_max_pct:g} %",
         s.eta_true_max_pct <= demo.eta_max_pct),
        ("true vertical error, rms", f"{s.eta_true_rms_pct:.4f} %", f"{demo.eta_rms_pct:g} %",
         s.eta_true_rms_pct <= demo.eta_rms_pct),
        ("error the cell saw, max", f"{s.eta_cell_max_pct:.4f} %", "", None),
        ("CAN frames lost", f"{s.frames.lost} of {s.frames.sent + s.frames.received}", f"{demo.frames_lost_max}",
         s.frames.lost <= demo.frames_lost_max),
        ("trips", "yes" if s.tripped else "none", "none", not s.tripped),
    ]  # fmt: skip
    if s.telemetry is not None:
        met = s.telemetry.lost <= demo.samples_lost_max
        lost = f"{s.telemetry.lost} of {s.telemetry.produced}"
        table.append(("telemetry samples lost", lost, f"{demo.samples_lost_max}", met))
    table.append(("ticks skipped", f"{s.skipped_ticks} of {s.ticks + s.skipped_ticks}", "", None))
    for name, values in (("lateness", s.lateness_us), ("work", s.work_us)):
        if values is not None:
            table.append((f"{name} p50 / p99 / p99.9 / max", _four(values), "", None))
    return table


def _four(values: dict[str, float]) -> str:
    return " / ".join(f"{values[name]:.0f}" for name in metrics.PERCENTILES) + " us"
