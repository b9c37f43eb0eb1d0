"""``make wheel``: the wheel of the commit checked out, built twice to the same bytes, and its SBOM.

The wheel carries the documentation, which `rigctl page` serves.

The tree is taken from git, so that nothing lies in the wheel that is not committed; times in it are the commit's.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import pathlib
import shutil
import subprocess
import sys
import tarfile
import tempfile

import sbom

ROOT = pathlib.Path(__file__).parents[2]
SITE = "rigctl/page/site"


class BuildError(RuntimeError):
    """No reproducible wheel; ``str()`` is one line."""


def git(*arguments: str) -> bytes:
    """Output of a git command in the checkout.

    Raises:
        BuildError: git refuses it.
    """
    found = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=False)
    if found.returncode:
        raise BuildError(f"git {arguments[0]}: {found.stderr.decode(errors='replace').strip().splitlines()[-1]}")
    return found.stdout


def unpacked(tree: bytes, into: pathlib.Path) -> pathlib.Path:
    """A tree (tar) as a folder."""
    with tarfile.open(fileobj=io.BytesIO(tree)) as archive:
        archive.extractall(into)  # Debian 12 has no argument filter; the tree is of this repository
    return into


def documentation(tree: bytes, epoch: int, folder: pathlib.Path) -> pathlib.Path:
    """The documentation site of a tree (tar), built in ``folder``.

    Raises:
        BuildError: the build fails, for a broken link among others.
    """
    source = unpacked(tree, folder / "source")
    run("mkdocs", "build", "--quiet", "--strict", "-f", str(source / "deploy/docs/mkdocs.yml"), epoch=epoch)
    return source / SITE


def built(tree: bytes, site: pathlib.Path, epoch: int, folder: pathlib.Path) -> pathlib.Path:
    """A wheel of a tree (tar) with its documentation, built in ``folder``.

    Raises:
        BuildError: the build fails.
    """
    source, out = unpacked(tree, folder / "source"), folder / "wheel"
    shutil.copytree(site, source / SITE)
    offline = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check"]
    run("pip", "wheel", *offline, "--wheel-dir", str(out), str(source), epoch=epoch)
    return next(out.glob("*.whl"))


def run(module: str, *arguments: str, epoch: int) -> None:
    """Run a Python module of the virtual environment, so that its output does not depend on when and where.

    Raises:
        BuildError: it fails.
    """
    found = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        capture_output=True, text=True, check=False, umask=0o022,
        env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch), "PYTHONHASHSEED": "0", "LC_ALL": "C.UTF-8"},
    )  # fmt: skip
    if found.returncode:
        raise BuildError(f"{module} {arguments[0]}: {(found.stderr.strip().splitlines() or ['it failed'])[-1]}")


def make(commit: str, into: pathlib.Path) -> pathlib.Path:
    """Build the wheel of a commit and its SBOM; returns the wheel.

    Raises:
        BuildError: the build fails, or two builds differ.
    """
    tree = git("archive", "--format=tar", commit)
    epoch = int(git("log", "-1", "--format=%ct", commit))
    into.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as docs,
        tempfile.TemporaryDirectory() as one,
        tempfile.TemporaryDirectory(prefix="another-") as other,
    ):
        site = documentation(tree, epoch, pathlib.Path(docs))
        wheels = [built(tree, site, epoch, pathlib.Path(folder)) for folder in (one, other)]
        contents = [wheel.read_bytes() for wheel in wheels]
        if contents[0] != contents[1]:
            raise BuildError(f"{wheels[0].name}: two builds of one commit differ")
        wheel = into / wheels[0].name
        wheel.write_bytes(contents[0])
    digest = hashlib.sha256(contents[0]).hexdigest()
    bom = wheel.with_suffix(".cdx.json")
    bom.write_text(sbom.of(ROOT / "deploy" / "release", wheel.name, digest, epoch))
    (into / "SHA256SUMS").write_text(
        f"{digest}  {wheel.name}\n{hashlib.sha256(bom.read_bytes()).hexdigest()}  {bom.name}\n"
    )
    return wheel


def main() -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the wheel of a commit, twice to the same bytes, and its SBOM.")
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--into", type=pathlib.Path, default=ROOT / "dist", help="folder [dist]")
    arguments = parser.parse_args()
    try:
        wheel = make(arguments.commit, arguments.into)
    except (BuildError, sbom.LockError, OSError) as error:
        sys.stderr.write(f"wheel: {error}\n")
        return 1
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    sys.stdout.write(f"{wheel}, built twice to the same bytes, sha256 {digest}\n")
    sys.stdout.write(f"{wheel.with_suffix('.cdx.json')}, CycloneDX\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
