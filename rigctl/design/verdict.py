"""Verdict on a design: margins with each plant, the result over the family, and both in words."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

from rigctl.control.law.gain_table import ScheduledGains, plain
from rigctl.control.law.tension import Gains
from rigctl.design.performance import Performance
from rigctl.design.plant_family import ASSUMED


@dataclass(frozen=True)
class MemberMargins:
    """Robustness of one plant of the family; an unstable loop has ``ms`` infinite and no margins."""

    k_m: float | None  # mechanism's stiffness N/mm, None = rigid
    k_scale: float
    delay_scale: float
    ms: float  # at the plant's input
    ms_output: float  # at the tension output
    gm_db: float  # smallest change of gain, up or down, that ends stability
    pm_deg: float
    dm_ms: float  # smallest further delay that ends stability
    stable: bool
    lag_scale: float = 1.0

    @property
    def ms_worst(self) -> float:
        """The larger of the two peaks, which is judged."""
        return max(self.ms, self.ms_output)

    def as_dict(self) -> dict[str, Any]:
        """As JSON values; an infinite figure becomes null."""
        return {name: None if value in (math.inf, -math.inf) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class SettingMargins:
    """One setting of the filter: ``open``, ``quiet`` or a level between them."""

    name: str
    ms_max: float  # over the family, both places
    performance: Performance | None
    level: float = 1.0  # 0 quiet, 1 open

    def as_dict(self) -> dict[str, Any]:
        """As JSON values; an infinite figure becomes null."""
        return {
            "name": self.name,
            "level": self.level,
            "ms_max": self.ms_max if math.isfinite(self.ms_max) else None,
            "performance": asdict(self.performance) if self.performance else None,
        }


@dataclass(frozen=True)
class GainSource:
    """The gain file that gave the gains."""

    file: str  # as the rig file names it
    provenance: dict[str, Any]  # as the file has it
    edited: bool  # the gains do not follow from its inputs
    seal: str = "no seal"
    identified: tuple[str, ...] = ()  # date of each identification that they are for


@dataclass(frozen=True)
class Design:
    """Gains with their verdict.

    ``accepted``: stable and below the limit everywhere, or waived in words. A waiver is for plants that the rig does
    not have: with the mechanism in the file the loop must be stable at every k and delay. It does not cover gains that
    were edited later.
    """

    gains: Gains
    margins: tuple[MemberMargins, ...]
    reported: tuple[MemberMargins, ...]  # K_m = 2 N/mm: shown, not judged
    ms_max: float  # over the family, both places
    limit: float
    accepted: bool
    waiver: str | None  # the words, only if they were needed
    performance: Performance | None  # None where the loop is unstable with the plant in the file
    source: GainSource | None = None  # None = designed from the settings
    settings: tuple[SettingMargins, ...] = ()  # of a filter with a quiet setting; ``margins`` are the worst of them
    switching: float | None = None  # `rigctl.design.switching`, the least over the family; None: nothing switches
    family: str = ASSUMED  # which plants ``margins`` are of, see `rigctl.design.plant_family.Family`
    notes: tuple[str, ...] = ()  # further warnings, one line each

    def of_file(self, source: GainSource) -> Design:
        """The design as that of a gain file: no waiver covers gains that were edited."""
        if source.edited and self.waiver is not None:
            return replace(self, source=source, waiver=None, accepted=False)
        return replace(self, source=source)

    @property
    def worst_level(self) -> float:
        """Of the filter, where Ms is the largest: 0 quiet, 1 open."""
        return next((setting.level for setting in self.settings[2:]), 1.0)

    def as_dict(self) -> dict[str, Any]:
        """As JSON values; an infinite figure becomes null."""
        return {
            "gains": asdict(plain(self.gains)),
            "schedule": self._schedule(),
            "margins": [member.as_dict() for member in self.margins],
            "reported": [member.as_dict() for member in self.reported],
            "ms_max": self.ms_max if math.isfinite(self.ms_max) else None,
            "limit": self.limit,
            "accepted": self.accepted,
            "waiver": self.waiver,
            "performance": asdict(self.performance) if self.performance else None,
            "family": self.family,
            "source": asdict(self.source) if self.source else None,
            "settings": [setting.as_dict() for setting in self.settings],
            "switching": self.switching,
            "verdict": self.verdict(),
            "warnings": self.warnings(),
        }

    def _schedule(self) -> dict[str, Any] | None:
        """The table of the gains and its dwell time, see `rigctl.control.law.gain_table`; None without one."""
        if not isinstance(self.gains, ScheduledGains):
            return None
        return {"table": [asdict(entry) for entry in self.gains.table], "dwell_s": self.gains.dwell_s}

    def ms_in_words(self) -> str:
        """``Ms 1.585 over the assumed family of plants``, or ``... the family of plants identified 2026-11-23``."""
        if not math.isfinite(self.ms_max):
            return f"unstable with {sum(not m.stable for m in self.margins)} of {len(self.margins)} plants"
        digits = 3 if abs(self.ms_max - self.limit) > 0.001 else 6  # never "1.600, expected at most 1.6"
        family = "assumed family of plants" if self.family == ASSUMED else f"family of plants {self.family}"
        return f"Ms {self.ms_max:.{digits}f} over the {family}"

    def verdict(self) -> str:
        """One line: margins of the gains, whether they are accepted, and their source."""
        origin = ""
        if self.source:
            made = self.source.provenance
            inputs = made["inputs_sha256"][:12]
            origin = f"; gains of {self.source.file}, {made['date_utc']}, inputs {inputs}, {self.source.seal}"
        if not self.accepted and self.switching is not None and self.switching <= 0.0:
            return (
                f"design refused: {self.ms_in_words()}, and no Lyapunov function is common to the quiet and the open "
                f"setting of the filter (circle criterion {self.switching:.3f}, expected above 0){origin}"
            )
        if not self.accepted:
            return f"design refused: {self.ms_in_words()}, expected at most {self.limit:g}{self._way_out()}{origin}"
        return f"{self.ms_in_words()} (limit {self.limit:g}{', waived' if self.waiver else ''}){origin}"

    def warnings(self) -> list[str]:
        """Warnings for the operator while the design runs, one line each."""
        found = list(self.notes)
        if self.source and self.source.edited:
            found.append(f"gains of {self.source.file} are not those its inputs give: edited by hand?")
        if self.accepted and self.waiver:
            found.append(
                f"{self.ms_in_words()}, expected at most {self.limit:g}, waived: {' '.join(self.waiver.split())}"
            )
        return found

    def _way_out(self) -> str:
        if self.source and self.source.edited:
            return " (its gains were edited by hand, no waiver covers that)"
        if self.waiver:
            return " (unstable with the mechanism in the file, no waiver helps)"
        look = "--auto" if self.family == ASSUMED else "--from LEDGER --optimize"
        return f" (or a design.waiver in words); rigctl tune {look} looks for weights that meet it"
