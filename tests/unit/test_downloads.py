"""A download of the set-up is tried three times, and the last error's own text is printed (tests/guest/thrice)."""

from __future__ import annotations

import pathlib
import subprocess

import pytest

from tests.builders.paths import ROOT

DOWNLOAD = """#!/bin/sh
echo x >>"{tries}"
echo "error of try $(wc -l <"{tries}")" >&2
echo done
[ "$(wc -l <"{tries}")" -gt {fails} ]
"""


@pytest.mark.parametrize(("fails", "tries", "code"), [(0, 1, 0), (2, 3, 0), (9, 3, 1)])
def test_three_tries(tmp_path: pathlib.Path, fails: int, tries: int, code: int) -> None:
    counted, program, pause = tmp_path / "tries", tmp_path / "download", tmp_path / "bin/sleep"
    program.write_text(DOWNLOAD.format(tries=counted, fails=fails))
    pause.parent.mkdir()
    pause.write_text("#!/bin/sh\n")
    for file in (program, pause):
        file.chmod(0o755)
    done = subprocess.run(
        [ROOT / "tests/guest/thrice", program],
        env={"PATH": f"{pause.parent}:/usr/bin:/bin"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, len(counted.read_text().split())) == (code, tries)
    assert done.stdout == "done\n" * tries
    assert ("error of try 3" in done.stderr) is (code == 1)
    assert "error of try 2" not in done.stderr
    assert ("failed three times" in done.stderr) is (code == 1)


def test_every_download_of_the_set_up_is_tried_three_times() -> None:
    files = ["Makefile", "tests/guest/apt", "tests/guest/setup"]
    lines = [line for name in files for line in (ROOT / name).read_text().splitlines()]
    fetching = [line for line in lines if "apt-get -qq" in line or "$(PIP) " in line]
    fetching += [line for line in lines if 'guest-setup"' in line]
    assert len(fetching) >= 5
    assert all("thrice" in line for line in fetching), fetching
