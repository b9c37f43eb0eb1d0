"""What is known not to be as expected in a row of the catalogue: a list that only shrinks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rigctl.model.states import Mode

KNOWN_MISSES: Mapping[tuple[str, Mode], Mapping[str, str]] = {
    ("torque_lost", Mode.FAULT): {
        "brake does not hold in": "a drive without torque reports off 0.3 s before its brake closes, three times as "
        "long as the rig file says; the stroke moves meanwhile, as on a brake that slips",
    },
    **{
        (f"cell_frozen_encoder_drifts_{drift}", Mode.HOLD): dict.fromkeys(
            ("held by the brake in", "load at rest in"),
            "the motor follows an encoder that drifts, which shows a stroke at rest, as the frozen cell does",
        )
        for drift in ("up_100", "up_400", "down_400", "down_100_stiff", "down_200_highest")
    },
    **{
        ("drive_frozen", mode): {"drive enabled in": "the frozen statusword is that of an enabled drive"}
        for mode in (Mode.HOLD, Mode.FAULT)
    },
    **{
        ("cell_noisy", mode): {
            "the load moved at": "three times the stated noise surprises the filter in every tenth sample, and the law "
            "follows what surprises it: the tension wanders by 0.7 N rms",
        }
        for mode in (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
    },
}
"""By row and mode: how the finding begins, and why there is one."""


def beyond_known(findings: Sequence[str], row: str, mode: Mode) -> Iterator[str]:
    """The findings that are not known, and the known ones that are no longer there."""
    known = KNOWN_MISSES.get((row, mode), {})
    yield from (found for found in findings if not found.startswith(tuple(known)))
    for words in known:
        if not any(found.startswith(words) for found in findings):
            yield f"{words}: no longer found here, so take it off the known misses"
