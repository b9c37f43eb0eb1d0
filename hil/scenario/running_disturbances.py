"""Disturbances that begin while the rig runs, each at its own time, and add up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hil.plant import Plant
from hil.plant.inputs import Track
from hil.plant.layout import RUN_OUT
from hil.scenario import consistency, disturbances
from hil.scenario.kinds import LONGEST_S, Disturbances
from rigctl.config.one_line import on_one_line
from rigctl.config.settings import RigSettings
from rigctl.config.strict_yaml import dotted


class RunningDisturbances:
    """What has been begun on a plant, of which every motion goes on from where it is."""

    def __init__(self, plant: Plant, settings: RigSettings) -> None:
        self._plant, self._settings = plant, settings
        self._origin_ns: int | None = None
        self._begun: dict[int, list[Track]] = {}

    def begin(self, wanted: Mapping[str, Any]) -> None:
        """Begin disturbances now, beside those that have begun before.

        Args:
            wanted: what stands below ``disturbances`` in a scenario file, see docs/scenario.md.

        Raises:
            ValueError: one of them is not valid, or this rig cannot have it; one line.
        """
        found = _validated(wanted)
        for (_, *path), value, allowed in consistency.of_rig(found, self._settings):
            raise ValueError(f"{dotted(tuple(path))}: found {value}, expected {allowed}")
        if self._origin_ns is None:
            self._origin_ns = self._plant.t_ns
        since_s = (self._plant.t_ns - self._origin_ns) * 1e-9
        for channel, track in disturbances.tracks(found, LONGEST_S).items():
            later = track if channel == RUN_OUT else _later(track, since_s)  # the run-out goes by angle
            self._begun.setdefault(channel, []).append(later)
        together = {channel: disturbances.summed(tracks) for channel, tracks in self._begun.items()}
        self._plant.start_motion(together, self._origin_ns)


def _validated(wanted: Mapping[str, Any]) -> Disturbances:
    try:
        return Disturbances.model_validate(wanted)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"{where}: {first['msg']}, found {on_one_line(repr(first['input']))}") from None


def _later(track: Track, seconds: float) -> Track:
    segments, tones = track.segments.copy(), track.tones.copy()
    segments[:, 0] += seconds
    tones[:, 3:5] += seconds
    return Track(segments, tones, track.end + seconds)
