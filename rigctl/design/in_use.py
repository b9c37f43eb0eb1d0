"""The design of a rig: that of its gain file, judged now, or a new one where there is none.

A gain file for an identified plant replaces the rig file's plant, and is judged over the family about that plant. It is
believed as long as the ledger bears it out: the identification is on record, is not older than `design.identify_days`,
and nothing that was measured since contradicts it. If it is not believed, the rig runs by the rig file alone, over the
assumed family, with a warning that says why.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import NamedTuple

from pydantic import ValidationError

from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.gain_table import ScheduledGains, TableEntry
from rigctl.control.law.tension import Gains
from rigctl.design import identified, plant_family
from rigctl.design.gain_file import (
    INPUTS,
    GainFileError,
    Provenance,
    SpringGains,
    checked_seal,
    inputs_in_full,
    parse,
    text_of,
)
from rigctl.design.identified import Identified
from rigctl.design.kept_results import JudgedLoop, KeptResults
from rigctl.design.plant_family import Family
from rigctl.design.transitions import TransitionError
from rigctl.design.verdict import Design, GainSource
from rigctl.ipc import ledger

SAME_GAIN = 1e-6  # relative: the last digits of a gain differ between versions of the libraries


class Kept(NamedTuple):
    """What a gain file has for a rig."""

    gains: SpringGains
    provenance: Provenance
    sealed: str  # what its seal says, in words


def read_for(settings: RigSettings) -> Kept | None:
    """What the gain file in the settings has for their spring; None if they name none.

    Raises:
        GainFileError: it cannot be read, was edited since it was sealed, or was made for other settings.
    """
    if settings.design.gains_file is None:
        return None
    file = settings.file(settings.design.gains_file)
    text = text_of(file)
    found, sealed = parse(text, str(file)), checked_seal(settings, text, str(file))
    differences = [spring.differs(settings) for spring in found.springs]
    if None not in differences:
        others = f", nor for another of its {len(differences)} springs" if len(differences) > 1 else ""
        raise GainFileError(f"{file}: made for other settings ({differences[0]}{others}): run `rigctl tune` again")
    return Kept(found.springs[differences.index(None)], found.provenance, sealed)


def adopted(settings: RigSettings, now: datetime | None = None) -> RigSettings:
    """The settings a rig runs with: those of the rig file, and in their place what its gain file replaces.

    Raises:
        GainFileError: as `read_for`, or a replaced value is out of its bounds.
    """
    kept = read_for(settings)
    if kept is None or _why_not_believed(kept.gains, settings, now) is not None:
        return settings
    return _applied(kept.gains, settings)


def design_in_use(settings: RigSettings, now: datetime | None = None, results: KeptResults | None = None) -> Design:
    """The design of a rig, judged now: that of its gain file, or a new one without a file.

    ``settings``: of the rig file, or as `adopted`. ``results``: of the start before; None computes everything.

    Raises:
        DesignError: there are no gains for these settings, or the gain file does not fit them.
    """
    kept, results = read_for(settings), results or KeptResults()
    if kept is None:
        return _noted(_new(settings, results), settings)
    name = str(settings.design.gains_file)
    if (why := _why_not_believed(kept.gains, settings, now)) is not None:
        note = f"the gains of {name} are not used, but new ones over the assumed family: {why}; identify and tune again"
        return replace(_new(settings, results), notes=(note,))
    of_file = changed(settings, {key: value.file for key, value in kept.gains.replaces.items()})
    found = _judged(_applied(kept.gains, settings), kept, name, results, of_file, now)
    return found if kept.gains.plant is not None else _noted(found, settings)


def _new(settings: RigSettings, results: KeptResults) -> Design:
    """Gains for the rig file alone, over the assumed family."""
    return results.judged(JudgedLoop(settings, results.gains(settings), None))


def _noted(found: Design, settings: RigSettings) -> Design:
    """With a warning where the loop's sensitivity was measured to differ from what the assumed family has."""
    try:
        why = identified.differing(ledger.read(settings), None)
    except ledger.LedgerError:  # the preflight refuses such a ledger
        return found
    return found if why is None else replace(found, notes=(*found.notes, f"{why}; identify and tune again"))


def family_in_use(settings: RigSettings, now: datetime | None = None) -> Family:
    """The plants over which the gains of a running rig were judged, with every loss. ``settings``: as `adopted`.

    Raises:
        GainFileError: as `read_for`.
    """
    kept = read_for(settings)
    if kept is None or kept.gains.plant is None or _why_not_believed(kept.gains, settings, now) is not None:
        return plant_family.with_losses(settings)
    return identified.family(settings, kept.gains.plant)


def design_while_running(settings: RigSettings, text: str, name: str, now: datetime | None = None) -> Design:
    """The design of a gain file's text on a rig that runs with ``settings``; only its weights may differ from them.

    Raises:
        GainFileError: it is not a gain file, was edited since it was sealed, is for another rig, plant, rate or
            estimator, its identification is not believed, or it has no margins.
    """
    found, sealed = parse(text, name), checked_seal(settings, text, name)
    if found.provenance.rig != settings.rig:
        raise GainFileError(f"{name}: found gains of rig {found.provenance.rig!r}, expected {settings.rig!r}")
    refused = []
    for spring in found.springs:
        weights = spring.inputs.get("design", {})
        if weights.keys() != set(INPUTS["design"]) or any(value is None or value <= 0.0 for value in weights.values()):
            raise GainFileError(f"{name}: its inputs hold no weights of the design: run `rigctl tune` again")
        made_for = settings.model_copy(update={"design": settings.design.model_copy(update=weights)})
        difference = spring.model_copy(update={"replaces": {}}).differs(made_for)
        if difference is None:
            if (why := _why_not_believed(spring, settings, now) or _why_barred(spring, settings)) is not None:
                raise GainFileError(f"{name}: {why}: identify and tune again")
            return _judged(made_for, Kept(spring, found.provenance, sealed), name, KeptResults())
        if spring.replaces and spring.differs(made_for) is None:
            kept = [key for key in spring.replaces if not key.startswith("design.")]
            raise GainFileError(
                f"{name}: found gains that replace {', '.join(kept)} in the rig file, expected the design's weights "
                f"alone to differ while the rig runs: name the file as design.gains_file, and start the daemon again"
            )
        refused.append(difference)
    raise GainFileError(f"{name}: made for other settings ({refused[0]}): run `rigctl tune` on the file that runs")


def not_believed(plant: Identified, settings: RigSettings, now: datetime | None = None) -> str | None:
    """Why the ledger does not bear an identification out, in one line; None if it does."""
    try:
        entries = ledger.read(settings)
    except ledger.LedgerError as error:
        return str(error)
    known = {ledger.entry_digest(item) for item in entries}
    if not known.issuperset(plant.entries):
        return f"the identification of {plant.when[:10]} is not in the ledger {settings.ledger}"
    return identified.outdated(plant, settings, now or datetime.now(UTC)) or identified.contradicted(
        plant, entries, settings
    )


def _why_not_believed(gains: SpringGains, settings: RigSettings, now: datetime | None) -> str | None:
    plant = gains.plant
    return None if plant is None else not_believed(plant, settings, now)


def _why_barred(gains: SpringGains, settings: RigSettings) -> str | None:
    """Gains that no identification backs are barred while the loop's sensitivity is not the predicted one."""
    if gains.plant is not None:
        return None  # `identified.contradicted` has looked
    try:
        return identified.differing(ledger.read(settings), None)
    except ledger.LedgerError as error:
        return str(error)


def _applied(gains: SpringGains, settings: RigSettings) -> RigSettings:
    """The settings with what the gains replace, within the bounds of every setting."""
    try:
        return RigSettings.model_validate(gains.applied(settings).model_dump())
    except ValidationError as error:
        first = error.errors()[0]
        key, found = ".".join(map(str, first["loc"])), first.get("ctx", {})
        words = f"{found.get('key', key)}: {found.get('allowed', first['msg'])}"
        raise GainFileError(f"{settings.design.gains_file}: replaces: {words}") from None


def _judged(
    settings: RigSettings,
    kept: Kept,
    name: str,
    results: KeptResults,
    given: RigSettings | None = None,
    now: datetime | None = None,
) -> Design:
    """``given``: settings of the rig file; with them a gain table is used."""
    loop = JudgedLoop(settings, Gains(**kept.gains.gains.model_dump()), kept.gains.plant)
    own = results.gains(settings)
    edited = not all(math.isclose(asdict(loop.gains)[k], g, rel_tol=SAME_GAIN) for k, g in asdict(own).items())
    plants = [gains.plant for gains in (kept.gains, *kept.gains.points)]
    dates = tuple(plant.when for plant in plants if plant is not None)
    source = GainSource(name, kept.provenance.model_dump(), edited, kept.sealed, dates)
    try:
        found = results.judged(loop).of_file(source)
        return found if given is None or not kept.gains.points else _scheduled(found, loop, results, given, kept, now)
    except (ArithmeticError, ValueError) as error:  # numbers that no law has
        raise GainFileError(f"{settings.file(name)}: no margins for its gains: {error}") from None


def _scheduled(
    found: Design, first: JudgedLoop, results: KeptResults, given: RigSettings, kept: Kept, now: datetime | None
) -> Design:
    """The design with its gain table: every entry judged, and the changes between them proven.

    A table that is not borne out leaves the gains of the first entry, with a warning.
    """
    loops, settings = [first], first.settings
    table = [TableEntry(_tension_n(kept.gains, settings), found.gains, {}, _stroke_mm(kept.gains))]
    every = inputs_in_full(settings)
    worst = found.ms_max
    for point in kept.gains.points:
        if (why := _why_not_believed(point, given, now)) is not None:
            return _without_table(found, why)
        there, plant = _applied(point, given), point.plant
        if plant is None or point.differs(given) is not None:
            return _without_table(found, "an entry is for other settings")
        gains, own = Gains(**point.gains.model_dump()), results.gains(there)
        if not all(math.isclose(a, b, rel_tol=SAME_GAIN) for a, b in zip(gains.in_order, own.in_order, strict=True)):
            return _without_table(found, "gains of an entry are not those its inputs give: edited by hand?")
        loops.append(JudgedLoop(there, gains, plant))
        judged = results.judged(loops[-1])
        if not judged.accepted:
            return _without_table(found, f"the entry at {plant.tension_n:.0f} N has {judged.ms_in_words()}")
        worst = max(worst, judged.ms_max)
        believes = {
            f"{section}.{key}": value
            for section, keys in inputs_in_full(there).items()
            for key, value in keys.items()
            if value != every[section][key]
        }
        table.append(TableEntry(plant.tension_n, gains, believes, plant.stroke_mm))
    try:
        dwell_s = results.dwell_s(loops)
    except TransitionError as error:
        return _without_table(found, str(error))
    return replace(found, gains=ScheduledGains(*found.gains.in_order, tuple(table), dwell_s), ms_max=worst)


def _without_table(found: Design, why: str) -> Design:
    return replace(found, notes=(*found.notes, f"the gain table is not used, only its first entry: {why}"))


def _tension_n(gains: SpringGains, settings: RigSettings) -> float:
    return settings.tension.target_n if gains.plant is None else gains.plant.tension_n


def _stroke_mm(gains: SpringGains) -> float | None:
    return None if gains.plant is None else gains.plant.stroke_mm
