"""Statements that are known to be false in a row of the catalogue: a list that only shrinks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rigctl.control.modes import Mode

KNOWN_MISSES: Mapping[tuple[str, Mode], Mapping[str, str]] = {
    ("torque_lost", Mode.FAULT): {
        "brake does not hold": "a drive without torque reports off 0.3 s before its brake closes, three times as long "
        "as the rig file says; the stroke moves meanwhile, as on a brake that slips",
    },
    ("cell_frozen_encoder_drifts_down_200_highest", Mode.HOLD): dict.fromkeys(
        ("held by the brake", "load at rest"),
        "the motor follows an encoder that drifts by 0.2 mm/s, which shows a stroke at rest, as the frozen cell does",
    ),
}
"""By row and mode: the statement that is false, and why it is."""


def beyond_known(false: Sequence[str], row: str, mode: Mode) -> Iterator[str]:
    """The false statements that are not known, and the known ones that are no longer false."""
    known = KNOWN_MISSES.get((row, mode), {})
    yield from (found for found in false if not any(found.startswith(f"{words} in ") for words in known))
    for words in known:
        if not any(found.startswith(f"{words} in ") for found in false):
            yield f"{words}: no longer false here, so take it off the known misses"
