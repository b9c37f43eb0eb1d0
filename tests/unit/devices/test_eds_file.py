"""EDS files as the field has them: read as they mean it, or refused in one line that names file and object."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable

import pytest

from rigctl.config.settings import RigSettings
from rigctl.devices import eds_file
from rigctl.devices import objects as od
from rigctl.devices.eds_file import EdsError
from tests.builders.paths import ROOT
from tests.builders.rig_bench import SETTINGS, changed
from tests.builders.rig_on_hub import RigOnHub

DRIVE = (ROOT / "config/eds/cylinder_drive.eds").read_text()
CELL = (ROOT / "config/eds/tension_amplifier.eds").read_text()
File = Callable[[str | bytes], pathlib.Path]


@pytest.fixture
def file(tmp_path: pathlib.Path) -> File:
    def written(text: str | bytes) -> pathlib.Path:
        path = tmp_path / "field.eds"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return written


def with_eds(path: pathlib.Path, section: str = "cylinder", settings: RigSettings = SETTINGS) -> RigSettings:
    return changed(settings, **{section: {"eds": str(path)}})


def refusal(path: pathlib.Path, section: str = "cylinder") -> str:
    with pytest.raises(EdsError) as refused:
        eds_file.check(with_eds(path, section))
    said = str(refused.value)
    assert said.isprintable()
    return said.replace(str(path), "FILE")


def starts(path: pathlib.Path, section: str = "cylinder") -> None:
    """The rig that is served with the original files comes up with this one."""
    rig = RigOnHub(SETTINGS)
    rig.settings = with_eds(path, section)
    eds_file.check(rig.settings)
    assert rig.bring_up().supervised


def section_of(text: str, name: str) -> str:
    found = re.search(rf"\[{name}\]\n(?:(?!\[).*\n)*", text)
    assert found is not None
    return found[0]


def without(text: str, name: str) -> str:
    return text.replace(section_of(text, name), "")


def other(text: str, name: str, old: str, new: str) -> str:
    before = section_of(text, name)
    assert re.search(old, before), f"[{name}] has no {old}"
    return text.replace(before, re.sub(old, new, before))


def test_a_pdo_without_a_mapping_that_a_start_does_not_use_is_nothing_to_it(file: File) -> None:
    starts(file(CELL + "\n[1802]\nParameterName=TPDO 3\nObjectType=0x9\nSubNumber=1\n"), "tension_cell")


def test_one_that_it_uses_is_named_at_once_with_all_that_is_missing(file: File) -> None:
    text = re.sub(r"(?m)^\[1A01", "[1A0F", DRIVE)
    assert refusal(file(text)) == (
        "FILE: cylinder.eds: found no objects 0x1A01:00, 0x1A01:01, 0x1A01:02, 0x1A01:03, expected all 4 (a start uses "
        "them)"
    )


@pytest.mark.parametrize(
    ("name", "kind", "found"),
    [
        ("6085", "0x0006", "0x6085:00 as UNSIGNED16, expected UNSIGNED32"),
        ("6040", "0x0007", "0x6040:00 as UNSIGNED32, expected UNSIGNED16"),
        ("1018sub1", "0x0009", "0x1018:01 as VISIBLE_STRING, expected UNSIGNED32"),
        ("60FF", "0x00AB", "0x60FF:00 as type 0x00AB, expected INTEGER32"),
    ],
)
def test_an_object_of_another_width_is_refused_with_both_types(file: File, name: str, kind: str, found: str) -> None:
    text = other(DRIVE, name, r"DataType=\w+", f"DataType={kind}")
    assert refusal(file(text)) == f"FILE: cylinder.eds: found {found}"


def test_the_sign_of_a_type_is_the_profiles(file: File) -> None:
    """Vendors mix both up; a target of -1 that a former controller left must not be read as 4 294 967 295."""
    path = file(other(DRIVE, "60FF", "DataType=0x0004", "DataType=0x0007"))
    starts(path)
    assert eds_file.read(with_eds(path), "cylinder")[od.TARGET_VELOCITY, 0].code == "i"


def test_the_file_of_another_device_is_refused_with_what_it_lacks(file: File) -> None:
    said = refusal(file(CELL))
    assert said.startswith("FILE: cylinder.eds: found no objects 0x6041:00, 0x6064:00, ")
    assert said.endswith("and 9 more, expected all 17 (a start uses them)")


@pytest.mark.parametrize(
    "text",
    [
        DRIVE.replace("CreatedBy=", "CreatedBy=Müller ").encode("cp1252"),
        DRIVE.encode("utf-8-sig"),
        DRIVE.encode("utf-16"),
        DRIVE.replace("\n", "\r\n").encode(),
        re.sub(r"PDOMapping=\d", "PDOMapping=", DRIVE),
        re.sub(r"AccessType=\w+", "AccessType=", DRIVE),
        re.sub(r"(?m)^\[(.*)\]$", lambda found: found[0].upper(), DRIVE),
        re.sub(r"(?m)^\[(.*)\]$", lambda found: found[0].lower(), DRIVE),
        re.sub(r"(?m)^\w+=", lambda found: f" {found[0].lower()[:-1]} = ", DRIVE),
        re.sub(r"DataType=0x", "DataType=0", DRIVE),
        re.sub(r"(?m)^(DataType=.*)$", r"\1   ; a type", DRIVE),
        DRIVE + "\nnothing that an EDS file has\n[9999]\nDataType=what\n",
    ],
    ids=["cp1252", "BOM", "UTF-16", "CRLF", "no PDOMapping", "no AccessType", "SUB1", "lower", "spaces", "octal",
         "comments", "odd lines"],
)  # fmt: skip
def test_what_vendors_write_otherwise_is_read(file: File, text: str | bytes) -> None:
    assert (text if isinstance(text, bytes) else text.encode()) != DRIVE.encode()
    starts(file(text))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (other(DRIVE, "6040", r"DataType=\w+", "DataType="), "[6040]: found no DataType, expected a number"),
        (other(DRIVE, "6040", r"DataType=\w+", "DataType=x"), "[6040]: found DataType x, expected a number"),
        (other(DRIVE, "6040", r"DataType=\w+\n", ""), "[6040]: found no DataType, expected a number"),
        (DRIVE + section_of(DRIVE, "60FF"), "[60FF]: found it again, expected it once"),
        (other(DRIVE, "60FF", "$", "DataType=0x0003\n"), "[60FF]: found it again, expected it once"),
    ],
)
def test_a_section_that_says_nothing_is_refused_with_its_line(file: File, text: str, said: str) -> None:
    path = file(text)
    found = re.fullmatch(r"FILE:(\d+): (.*)", refusal(path))
    assert found is not None
    assert found[2].startswith(said)
    near = text.splitlines()[int(found[1]) - 1]
    assert near.startswith(("[60", "DataType")), "the line is the one that it is about"


def test_a_record_without_its_sections_has_no_sub_indices_but_a_compact_one(file: File) -> None:
    bare = re.sub(r"(?ms)^\[1018sub\d\].*?(?=^\[)", "", DRIVE)
    assert "0x1018:01" in refusal(file(bare))
    starts(file(other(bare, "1018", "ObjectType=0x9", "ObjectType=0x8\nDataType=0x0007\nCompactSubObj=4")))
    short = other(bare, "1018", "ObjectType=0x9", "ObjectType=0x8\nDataType=0x0007\nCompactSubObj=3")
    assert "found no object 0x1018:04," in refusal(file(short))


def test_sub_index_0_of_an_object_with_others_is_not_its_head(file: File) -> None:
    assert "0x1A00:00" in refusal(file(without(DRIVE, "1A00sub0")))


def test_an_optional_object_may_be_missing_but_not_be_another(file: File) -> None:
    path = file(without(DRIVE, "607E"))
    eds_file.check(with_eds(path))
    assert (od.POLARITY, 0) not in eds_file.read(with_eds(path), "cylinder")
    assert "0x607E:00 as UNSIGNED32" in refusal(file(other(DRIVE, "607E", r"DataType=\w+", "DataType=7")))


@pytest.mark.parametrize("text", ["", "a letter to the editor\n", "[DeviceInfo]\nVendorName=x\n"])
def test_a_file_without_objects_is_no_eds_file(file: File, text: str) -> None:
    assert refusal(file(text)) == "FILE: found no objects, expected an EDS file as in CiA 306"
