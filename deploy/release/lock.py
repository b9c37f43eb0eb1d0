"""``make lock``: requirements with hashes, one file for each extra, for the offline wheelhouse.

pip resolves each extra within constraints.txt and says the hash of every wheel it would install on this platform. The
files name no index:

    pip download --require-hashes -d wheelhouse -r deploy/release/requirements-rt.txt
    pip install --no-index --find-links wheelhouse --require-hashes -r deploy/release/requirements-rt.txt
    pip install --no-index --no-deps rigctl-*.whl
"""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).parents[2]
FOLDER = pathlib.Path(__file__).parent
EXTRAS = ("rt", "ops", "sim")
HEADER = (
    "# Made by `make lock` from constraints.txt: what rigctl[{extra}] installs on CPython {python}, {platform}.\n"
    "# pip install --require-hashes -r requirements-{extra}.txt\n"
)


def resolved(extra: str) -> list[tuple[str, str, str]]:
    """Name, version and SHA-256 of every wheel that an extra needs, in the order of names.

    Raises:
        RuntimeError: pip cannot resolve it; ``str()`` is one line.
    """
    found = subprocess.run(
        [
            sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed",
            "--only-binary", ":all:", "--disable-pip-version-check", "--report", "-",
            "-c", str(ROOT / "constraints.txt"), f"rigctl[{extra}] @ {ROOT.as_uri()}",
        ],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if found.returncode:
        raise RuntimeError(f"pip: {(found.stderr.strip().splitlines() or ['it failed'])[-1]}")
    wheels = []
    for item in json.loads(found.stdout)["install"]:
        about, info = item["metadata"], item["download_info"]
        if about["name"] != "rigctl":
            wheels.append((about["name"], about["version"], info["archive_info"]["hashes"]["sha256"]))
    return sorted(wheels, key=lambda wheel: wheel[0].lower())


def main() -> int:
    """Write the files; returns the exit code."""
    python, platform = f"{sys.version_info.major}.{sys.version_info.minor}", "Linux x86_64"
    try:
        for extra in EXTRAS:
            lines = [f"{name}=={version} \\\n    --hash=sha256:{digest}\n" for name, version, digest in resolved(extra)]
            file = FOLDER / f"requirements-{extra}.txt"
            file.write_text(HEADER.format(extra=extra, python=python, platform=platform) + "".join(lines))
            sys.stdout.write(f"{file.relative_to(ROOT)}: {len(lines)} distributions\n")
    except (RuntimeError, OSError, KeyError, ValueError) as error:
        sys.stderr.write(f"lock: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
