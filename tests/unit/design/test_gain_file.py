"""Gain files: their content, their inputs, and which of them are refused."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest

from rigctl.config import strict_yaml
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings
from rigctl.design import gain_file
from rigctl.design.gain_file import GainFileError, inputs, provenance, read, sha256, write
from rigctl.design.in_use import design_in_use, design_while_running, read_for
from rigctl.design.margins import design_and_check
from rigctl.ipc import seal

Rig = Callable[..., RigSettings]
NOON = datetime(2026, 11, 21, 13, 0, 0, tzinfo=timezone(timedelta(hours=1)))
WAIVER = "a test of the waiver"


@pytest.fixture
def kept(rig: Rig, tmp_path: pathlib.Path) -> pathlib.Path:
    """A gain file of the paper's rig."""
    file = tmp_path / "gains.yaml"
    write(file, design_and_check(rig()), provenance(rig(), pathlib.Path("config/paper_rig.yaml"), NOON))
    return file


def using(file: pathlib.Path, settings: RigSettings, **design: Any) -> RigSettings:
    changed = settings.design.model_copy(update={"gains_file": file.name, **design})
    return settings.model_copy(update={"design": changed, "directory": str(file.parent)})


def edit(file: pathlib.Path, pattern: str, to: str) -> None:
    text, count = re.subn(pattern, to, file.read_text())
    assert count == 1
    file.write_text(text)


def test_what_is_written_is_read_to_the_last_digit(rig: Rig, kept: pathlib.Path) -> None:
    fresh, found = design_and_check(rig()), read(kept)
    assert found.gains.model_dump() == asdict(fresh.gains)
    assert found.verdict.ms_max == fresh.ms_max
    assert found.verdict.accepted
    made = found.provenance
    assert (made.rig, made.rig_file) == ("paper_rig", "config/paper_rig.yaml")
    assert made.date_utc == "2026-11-21T12:00:00+00:00"
    assert set(made.versions) == {"rigctl", "python-control", "filterpy", "numpy", "scipy", "python"}
    assert made.inputs == inputs(rig())
    assert [file.name for file in kept.parent.iterdir()] == [kept.name]  # nothing half-written beside it


@pytest.mark.parametrize("hash_", ["1" * 64, "1e" + "0" * 62, "0x" + "f" * 62])
def test_a_hash_that_looks_like_a_number_stays_text(rig: Rig, kept: pathlib.Path, hash_: str) -> None:
    made = provenance(rig(), kept, NOON).model_copy(update={"inputs_sha256": hash_})
    write(kept, design_and_check(rig(design={"waiver": WAIVER, "ms_max": 1.3})), made)
    data = strict_yaml.load(kept.read_text()).data
    assert data["provenance"]["inputs_sha256"] == hash_
    assert data["verdict"]["waiver"] == WAIVER


def test_a_small_gain_and_an_infinite_ms_are_read_back(rig: Rig, kept: pathlib.Path) -> None:
    # k_tension goes with 1/k; PyYAML writes 1e-05 as 1.0e-05, which the strict reader accepts.
    settings = rig(plant={"spring_n_mm": None, "rope_n_mm": 1e5}, design={"stretch_weight": 1e-3})
    found = design_and_check(settings)
    assert found.gains.k_tension < 1e-4
    write(kept, found, provenance(settings, kept, NOON))
    assert read(kept).gains.model_dump() == asdict(found.gains)


def _leaves(settings: Settings, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    found: dict[tuple[str, ...], Any] = {}
    for key in type(settings).model_fields:
        value = getattr(settings, key)
        found |= _leaves(value, (*path, key)) if isinstance(value, Settings) else {(*path, key): value}
    return found


def _with(settings: Settings, path: tuple[str, ...], value: Any) -> Any:
    key, *rest = path
    return settings.model_copy(update={key: _with(getattr(settings, key), tuple(rest), value) if rest else value})


def test_every_input_changes_the_hash_and_nothing_else_does(rig: Rig) -> None:
    matters = {(section, key) for section, keys in gain_file.INPUTS.items() for key in keys}
    before = sha256(inputs(rig()))
    seen = set()
    for path, value in _leaves(rig()).items():
        if isinstance(value, bool):
            other: Any = not value
        elif isinstance(value, int | float):
            other = value + 1
        else:
            other = 7.0 if path in matters else f"{value}x"
        changed = sha256(inputs(_with(rig(), path, other))) != before
        assert changed == (path in matters), path
        seen |= {path} & matters
    assert seen == matters


def test_inputs_are_all_that_the_design_follows_from(rig: Rig) -> None:
    # A setting that changed the design but not the hash would let a stale file pass. Limit and waiver change only the
    # verdict, which is renewed at every start.
    matters = {(section, key) for section, keys in gain_file.INPUTS.items() for key in keys}
    fresh = design_and_check(rig())
    for path, value in _leaves(rig()).items():
        judged = path[0] in ("loop", "plant", "tension_cell", "estimator", "design", "tension", "cylinder")
        if path in matters or not judged or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        other = design_and_check(_with(rig(), path, value + 1))
        assert (other.gains, other.margins, other.performance) == (fresh.gains, fresh.margins, fresh.performance), path


def test_hash_is_canonical(rig: Rig) -> None:
    plain = inputs(rig())
    shuffled = {section: dict(reversed(keys.items())) for section, keys in reversed(plain.items())}
    whole = {s: {k: int(v) if v and v == int(v) else v for k, v in keys.items()} for s, keys in shuffled.items()}
    assert sha256(plain) == sha256(whole)


def test_a_file_that_fits_gives_the_same_design_with_its_provenance(rig: Rig, kept: pathlib.Path) -> None:
    found, fresh = design_in_use(using(kept, rig())), design_and_check(rig())
    assert (found.gains, found.margins, found.accepted) == (fresh.gains, fresh.margins, True)
    assert found.source is not None
    assert not found.source.edited
    assert found.source.provenance["inputs_sha256"] == sha256(inputs(rig()))
    assert "gains of gains.yaml, 2026-11-21" in found.verdict()
    assert found.warnings() == []
    assert design_in_use(rig()).source is None


def test_a_stale_file_is_refused_with_what_changed(rig: Rig, kept: pathlib.Path) -> None:
    with pytest.raises(GainFileError) as refused:
        design_in_use(using(kept, rig(plant={"spring_n_mm": 13.0})))
    said = str(refused.value)
    assert str(kept) in said
    assert "plant.spring_n_mm was 6, is 13" in said
    assert "run `rigctl tune` again" in said
    with pytest.raises(GainFileError, match=r"mechanism_n_mm was null, is 45"):
        read_for(using(kept, rig(plant={"mechanism_n_mm": 45.0})))


def test_limit_and_waiver_are_of_the_verdict_and_judged_now(rig: Rig, kept: pathlib.Path) -> None:
    assert not design_in_use(using(kept, rig(), ms_max=1.3)).accepted
    waived = design_in_use(using(kept, rig(), ms_max=1.3, waiver=WAIVER))
    assert waived.accepted
    assert WAIVER in waived.warnings()[0]


@pytest.mark.parametrize("gain", ["4.0", "400.0", "-1.0", "1.0e+9"])
@pytest.mark.parametrize("waiver", [None, WAIVER])
def test_an_edited_gain_that_is_not_robust_is_refused_waiver_or_not(
    rig: Rig, kept: pathlib.Path, gain: str, waiver: str | None
) -> None:
    edit(kept, r"k_tension: [\d.]+", f"k_tension: {gain}")
    found = design_in_use(using(kept, rig(), waiver=waiver))
    assert not found.accepted
    assert "edited" in found.verdict()


def test_an_edited_gain_that_is_robust_runs_and_is_told(rig: Rig, kept: pathlib.Path) -> None:
    edit(kept, r"k_tension: [\d.]+", "k_tension: 1.3")
    found = design_in_use(using(kept, rig()))
    assert found.accepted
    assert found.gains.k_tension == 1.3
    assert "edited by hand" in found.warnings()[0]


@pytest.mark.parametrize(
    ("pattern", "to", "said"),
    [
        (r"spring_n_mm: 6.0", "spring_n_mm: 13.0", "do not give its inputs_sha256"),
        (r"k_tension: [\d.]+", "k_tension: fast", "k_tension: found 'fast', expected a number"),
        (r"k_tension: [\d.]+", "k_tension: .nan", "a finite number"),
        (r"k_tension: [\d.]+", "k_tension: 1.0e+30", "k_tension: found 1e+30"),
        (r"k_tension: [\d.]+", "k_tensio: 1.0", "k_tensio: found an unknown key"),
        (r"(?s)provenance:.*", "", "provenance: found nothing"),
        (r"(?s).*", "", "the file is empty"),
        (r"(?s).+", "- 1\n", "found no gain file"),
        (r"(?s).+", "gains: [", "not YAML"),
    ],
)
def test_a_corrupt_file_is_one_line_that_names_it(kept: pathlib.Path, pattern: str, to: str, said: str) -> None:
    kept.write_text(re.sub(pattern, to, kept.read_text(), count=1))
    with pytest.raises(GainFileError) as refused:
        read(kept)
    assert str(kept) in str(refused.value)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_is_no_file_of_text_is_one_line(kept: pathlib.Path) -> None:
    for what, said in ((kept.parent, "Is a directory"), (kept.with_name("no.yaml"), "No such file")):
        with pytest.raises(GainFileError, match=said):
            read(what)
    kept.write_bytes(b"\x80\x81")
    with pytest.raises(GainFileError, match="not UTF-8"):
        read(kept)


def test_a_link_stays_a_link(rig: Rig, kept: pathlib.Path) -> None:
    link = kept.with_name("link.yaml")
    link.symlink_to(kept.name)
    write(link, design_and_check(rig()), provenance(rig(), kept, datetime.now(UTC)))
    assert link.is_symlink()
    assert not read(kept).provenance.date_utc.startswith("2026-11-21T12:00:00")


@pytest.fixture
def sealed(rig: Rig, kept: pathlib.Path) -> RigSettings:
    """Settings that use a sealed gain file."""
    settings = using(kept, rig())
    write(kept, design_and_check(rig()), read(kept).provenance, settings)
    return settings


def test_a_sealed_file_is_told_intact_and_one_made_elsewhere_has_no_seal(
    rig: Rig, kept: pathlib.Path, sealed: RigSettings
) -> None:
    assert ", sealed" in design_in_use(sealed).verdict()
    assert ", sealed" in design_while_running(sealed, kept.read_text(), "gains.yaml").verdict()
    assert seal.key_file(sealed, "gains").stat().st_mode & 0o777 == 0o600
    write(kept, design_and_check(rig()), read(kept).provenance)
    assert ", no seal" in design_in_use(sealed).verdict()


@pytest.mark.parametrize(
    "edit_", [(r"k_tension: [\d.]+", "k_tension: 1.3"), (r"date_utc: .*", 'date_utc: "x"'), (r"# Units", "#")]
)
def test_a_file_edited_since_it_was_sealed_is_refused(
    kept: pathlib.Path, sealed: RigSettings, edit_: tuple[str, str]
) -> None:
    edit(kept, *edit_)
    with pytest.raises(GainFileError, match="edited since it was sealed, or sealed on another computer") as refused:
        read_for(sealed)
    assert "\n" not in str(refused.value)
    with pytest.raises(GainFileError, match="edited since it was sealed"):
        design_while_running(sealed, kept.read_text(), "gains.yaml")
    edit(kept, r'seal: "[0-9a-f]{64}"\n', "")
    assert ", no seal" in design_in_use(sealed).verdict()  # judged as ever, and told


def test_another_rigs_seal_or_a_lost_key_is_no_seal_of_this_rig(sealed: RigSettings) -> None:
    seal.key_file(sealed, "gains").unlink()
    with pytest.raises(GainFileError, match="edited since it was sealed"):
        read_for(sealed)
