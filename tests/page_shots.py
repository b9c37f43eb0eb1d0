"""``python -m tests.page_shots DIR``: pictures of the live page in both themes and three sizes, to be looked at.

A real daemon on the simulated rig: tension on target with the rope swinging, a confirmation asked for, a fault, and a
page whose daemon has gone.
"""

from __future__ import annotations

import argparse
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

from playwright.sync_api import Browser

from tests.builders import daemons
from tests.builders.pages import PATIENT, PageView, Server, browser, look, serving
from tests.builders.paths import ROOT

BROWSER_PACKAGES = ("chromium", "fonts-dejavu-core")
SIZES = ((1920, 1080), (1024, 768), (820, 1180))
THEMES = ("light", "dark")


def shoot(seen: PageView, folder: pathlib.Path, name: str) -> None:
    """A picture of what the screen shows, and of the whole page where it is longer."""
    seen.page.screenshot(path=folder / f"{name}.png")
    if seen.run("document.documentElement.scrollHeight > innerHeight + 10"):
        seen.page.screenshot(path=folder / f"{name}-whole.png", full_page=True)


def everywhere(chromium: Browser, server: Server, folder: pathlib.Path, name: str) -> None:
    """One picture for each size and theme."""
    for width, height in SIZES:
        for theme in THEMES:
            seen = look(chromium, server.address, width, height, theme)
            seen.live()
            time.sleep(1.5)
            shoot(seen, folder, f"{name}-{width}x{height}-{theme}")
            seen.page.close()


def play(folder: pathlib.Path, work: pathlib.Path) -> None:
    """The rig through its states, pictures on the way."""
    file = daemons.rig_file(work, PATIENT)
    with (
        browser() as chromium,
        daemons.simulated_rig(file, work / "rig.log") as rig,
        daemons.daemon(file, work / "daemon.log"),
        serving(daemons.endpoint(file), "--operator", "kim") as server,
    ):
        everywhere(chromium, server, folder, "disarmed")
        for verb in (("lease", "take"), ("arm",), ("tension", "--wait")):
            answer = daemons.rigctl(*verb, file=file)
            print(answer.stdout or answer.stderr, end="")
        time.sleep(10.0)
        everywhere(chromium, server, folder, "compensating")
        server.command("lease", {"act": "take", "reason": "pictures"})
        for (width, height), theme in zip(SIZES, (*THEMES, "light"), strict=True):
            seen = look(chromium, server.address, width, height, theme)
            seen.live()
            seen.until("!document.querySelector('[data-verb=release]').dataset.why")
            seen.page.click("[data-verb=release]")
            seen.until("!document.querySelector('#confirm').hidden")
            shoot(seen, folder, f"confirm-{width}x{height}-{theme}")
            seen.page.close()
        rig.send_signal(signal.SIGSTOP)  # the bus falls silent
        everywhere(chromium, server, folder, "fault")
        rig.send_signal(signal.SIGCONT)
        seen = look(chromium, server.address, *SIZES[0])
        seen.live()
        os.kill(daemons.process_with("rigctl.gateway.gateway_process", daemons.name_of(file)), signal.SIGSTOP)
        seen.until("rigctl.stale")
        time.sleep(2.0)
        shoot(seen, folder, "stale-1920x1080-light")
        os.kill(daemons.process_with("rigctl.gateway.gateway_process", daemons.name_of(file)), signal.SIGCONT)


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_shots", description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, metavar="DIR", help="where the pictures go")
    folder = parser.parse_args().folder
    if subprocess.run([ROOT / "tests/guest/apt", *BROWSER_PACKAGES], check=False).returncode:
        sys.exit(1)  # it has said what is missing
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="rigctl-page-") as work:
        play(folder, pathlib.Path(work))
    print(f"{len(list(folder.glob('*.png')))} pictures in {folder}")


if __name__ == "__main__":
    main()
