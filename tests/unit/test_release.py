"""Releases: the same bytes each time, hashes for every wheel, a complete list of what is behind them."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
import zipfile
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.builders.paths import ROOT

RELEASE = ROOT / "deploy/release"
EXTRAS = ("rt", "ops", "sim")
HASHED = re.compile(r"^([A-Za-z0-9._-]+)==(\S+) \\\n    --hash=sha256:[0-9a-f]{64}\n", re.MULTILINE)


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().split()
    return {str(canonicalize_name(name)): version for name, _, version in (line.partition("==") for line in lines)}


def locked(extra: str) -> dict[str, str]:
    text = (RELEASE / f"requirements-{extra}.txt").read_text()
    return {str(canonicalize_name(name)): version for name, version in HASHED.findall(text)}


def closure(requirement: Requirement) -> set[str]:
    """Names of all distributions behind a requirement, by the metadata of those installed."""
    seen: set[tuple[str, str]] = set()
    waiting = [(requirement.name, extra) for extra in ("", *requirement.extras)]
    while waiting:
        name, extra = waiting.pop()
        key = (str(canonicalize_name(name)), extra)
        if key in seen:
            continue
        seen.add(key)
        for deeper in map(Requirement, metadata.requires(name) or []):
            if deeper.marker is None or deeper.marker.evaluate({"extra": extra}):
                waiting += [(deeper.name, further) for further in ("", *deeper.extras)]
    return {name for name, _ in seen}


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_lock_is_the_constraints_with_hashes(extra: str) -> None:
    text, constraints = (RELEASE / f"requirements-{extra}.txt").read_text(), pinned()
    found = locked(extra)
    entries = [line for line in text.splitlines() if line and not line.startswith(("#", " "))]
    assert len(entries) == len(found) > 10  # every entry has a hash
    assert {name: constraints.get(name) for name in found} == found, "make lock"
    assert not re.search(r"https?:|file:|--(extra-)?index|--find-links|@", text)


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_lock_is_all_that_the_extra_needs(extra: str) -> None:
    assert closure(Requirement(f"rigctl[{extra}]")) - {"rigctl"} == set(locked(extra)), "make lock"


def test_the_rigs_computer_carries_no_compiler_but_what_designs() -> None:
    assert not {"numba", "llvmlite", "pyarrow"} & set(locked("rt"))
    assert {"control", "filterpy", "matplotlib"} <= set(locked("rt"))
    assert "slycot" not in locked("sim")  # GPL; python-control does without it


def test_a_wheel_of_another_hash_is_refused_by_pip(tmp_path: pathlib.Path) -> None:
    (tmp_path / "msgspec-99-py3-none-any.whl").write_bytes(b"not the wheel that was locked")
    (tmp_path / "lock.txt").write_text(f"msgspec==99 --hash=sha256:{'0' * 64}\n")
    answer = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--no-index", "--find-links",
         str(tmp_path), "--target", str(tmp_path / "t"), "--require-hashes", "-r", str(tmp_path / "lock.txt")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.returncode != 0
    assert "DO NOT MATCH THE HASHES" in answer.stderr


@pytest.mark.long
def test_two_builds_are_one_wheel_with_its_sbom(tmp_path: pathlib.Path) -> None:
    """wheel.py builds in two folders, and refuses a difference."""
    command = [sys.executable, str(RELEASE / "wheel.py"), "--into", str(tmp_path / "one")]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    (wheel,) = (tmp_path / "one").glob("*.whl")
    assert {"rigctl/page/site/index.html", "rigctl/page/site/operate.html"} <= set(zipfile.ZipFile(wheel).namelist())
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=wheel.parent, check=True)

    bom = json.loads(wheel.with_suffix(".cdx.json").read_text())
    assert (bom["bomFormat"], bom["specVersion"]) == ("CycloneDX", "1.6")
    assert bom["metadata"]["component"]["name"] == "rigctl"
    listed = {str(canonicalize_name(item["name"])): item["version"] for item in bom["components"]}
    assert listed == {name: version for extra in EXTRAS for name, version in locked(extra).items()}
    assert all(item["hashes"][0]["alg"] == "SHA-256" for item in bom["components"])


def test_a_line_without_a_hash_is_refused(tmp_path: pathlib.Path) -> None:
    run = (
        "import pathlib, sbom\n"
        f"file = pathlib.Path({str(tmp_path / 'lock.txt')!r}); file.write_text('numpy==2\\n')\n"
        "try: list(sbom.locked(file))\n"
        "except sbom.LockError as error: print(error)"
    )
    answer = subprocess.run([sys.executable, "-c", run], cwd=RELEASE, capture_output=True, text=True, check=False)
    assert answer.stdout == "lock.txt: found 'numpy==2', expected NAME==VERSION --hash=sha256:...\n", answer.stderr
