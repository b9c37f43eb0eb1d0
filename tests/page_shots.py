"""``python -m tests.page_shots DIR [--everywhere] [--only NAME...]``: the live page in 4 modes and 8 faults.

A real daemon on the simulated rig, whose devices are made to fail one after the other. Each picture must answer by
itself: is it safe to walk in, why did it stop, what do I do, how long has it been so, which limit and which value.
``--everywhere`` takes each state on tablets and a phone and in the dark theme as well.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator

from PIL import Image
from playwright.sync_api import Browser

from tests.builders import daemons
from tests.builders.pages import PATIENT, Server, browser, look, serving
from tests.builders.paths import ROOT

BROWSER_PACKAGES = ("chromium", "fonts-dejavu-core")
SIZE = (1600, 900, "light")
ELSEWHERE = ((1180, 820, "light"), (1024, 768, "light"), (390, 844, "light"), (1600, 900, "dark"))
FAULTS = ("e_stop", "cell_silent", "cell_high", "rope_lost", "drive_trips", "runs_away")
# Slow motion and few status frames: the pictures may be taken on a busy computer.
SLOW = {"cylinder": {**PATIENT["cylinder"], "status_rate_hz": 5}, "tension": {"ramp_n_s": 10.0}}
TRIES = 5
COLOURS = 96  # of a picture: a third of the size, and no difference to be seen
SHOWN_S = 4.0  # a fault stands for some seconds, so that "since when" says something


@contextlib.contextmanager
def faulty_rig(file: pathlib.Path, log: pathlib.Path) -> Iterator[subprocess.Popen[str]]:
    """The served rig, with its standard input for faults."""
    with log.open("wb") as out:
        child = subprocess.Popen(
            [sys.executable, "-m", "tests.builders.faulty_rig", str(file)],
            stdin=subprocess.PIPE, stdout=out, stderr=subprocess.STDOUT, text=True, cwd=ROOT,
        )  # fmt: skip
    try:
        daemons.wait_for(lambda: child.poll() is not None or b"serving" in log.read_bytes(), log=log)
        yield child
    finally:
        child.kill()
        child.wait()


def say(rig: subprocess.Popen[str], fault: str) -> None:
    """Put a fault in, or with "" take all out."""
    assert rig.stdin is not None
    rig.stdin.write(f"{fault}\n")
    rig.stdin.flush()


class Album:
    """Pictures of one page server."""

    def __init__(self, chromium: Browser, server: Server, folder: pathlib.Path, everywhere: bool) -> None:
        self.chromium, self.server, self.folder, self.everywhere = chromium, server, folder, everywhere

    def take(self, name: str, file: pathlib.Path) -> None:
        """A picture of the rig in a mode, again where a busy computer has tripped it meanwhile."""
        for _ in range(TRIES):
            MODES[name](file)
            if name.upper() in self.shoot(name):
                return
        sys.exit(f"{name}: the rig was in another mode in each of {TRIES} pictures")

    def shoot(self, name: str) -> str:
        """A picture of the state now; returns the mode shown. No browser draws in between: that disturbs the loop."""
        for width, height, theme in (SIZE, *(ELSEWHERE if self.everywhere else ())):
            seen = look(self.chromium, self.server.address, width, height, theme)
            seen.until("window.rigctl && rigctl.draws > 1")
            time.sleep(1.0)
            more = "" if (width, height, theme) == SIZE else f"-{width}-{theme}"
            picture = Image.open(io.BytesIO(seen.page.screenshot()))
            picture.quantize(COLOURS).save(self.folder / f"page-{name.replace('_', '-')}{more}.png", optimize=True)
            shown = seen.text("#mode")
            print(f"{name}: {shown}; {seen.errors}", flush=True)
            seen.page.close()
        return shown


def rigctl(file: pathlib.Path, *verb: str) -> None:
    """A command of the operator; its answer is printed."""
    answer = daemons.rigctl(*verb, file=file)
    print((answer.stdout or answer.stderr).strip(), flush=True)


def held(file: pathlib.Path) -> None:
    """Armed, with a slack rope."""
    up(file)
    rigctl(file, "release", "--wait")


def ramping(file: pathlib.Path) -> None:
    """The tension on its way up."""
    held(file)
    rigctl(file, "tension")


def up(file: pathlib.Path, settle_s: float = 0.0) -> None:
    """The tension on its target, for some time."""
    for _ in range(60):
        state = daemons.state(file)
        if state.get("mode") == "COMPENSATING":
            time.sleep(settle_s)
            return
        if state.get("mode") == "FAULT":
            if any(
                cause["fault"] == "STROKE_JUMPED" for cause in state["causes"]
            ):  # a busy computer held the simulated drive up
                rigctl(file, "confirm-stroke", f"{state['stroke_mm']:.2f}")
            rigctl(file, "reset")
        elif state.get("mode") == "DISARMED":
            rigctl(file, "arm")
        elif state.get("mode") == "HOLD":
            rigctl(file, "tension", "--wait")
        time.sleep(1.0)
    raise AssertionError(f"the rig is not up: {daemons.state(file).get('fault_text')}")


def settled(file: pathlib.Path) -> None:
    """The tension on its target for a while, so that the charts show it."""
    up(file, settle_s=10.0)


MODES: dict[str, Callable[[pathlib.Path], None]] = {
    "disarmed": lambda _file: None, "hold": held, "tensioning": ramping, "compensating": settled,
}  # fmt: skip
"""A picture each, and how the rig gets there."""
NAMES = (*MODES, *FAULTS, "bus_silent", "loop_stopped")


def play(folder: pathlib.Path, work: pathlib.Path, everywhere: bool, names: Collection[str]) -> None:
    """The rig through the states of those names, pictures on the way."""
    file = daemons.rig_file(work, {**PATIENT, **SLOW})
    control = "rigctl.control"
    with (
        faulty_rig(file, work / "rig.log") as rig,
        daemons.daemon(file, work / "daemon.log"),
        contextlib.ExitStack() as stack,
    ):
        server = stack.enter_context(serving(daemons.endpoint(file), "--operator", "kim"))
        os.nice(15)  # from here on: the browser gives way to loop and page server
        chromium = stack.enter_context(browser())
        album = Album(chromium, server, folder, everywhere)
        rigctl(file, "lease", "take")
        for name in MODES:
            if name in names:
                album.take(name, file)
        for fault in FAULTS:
            if fault in names:
                up(file, settle_s=3.0)
                say(rig, fault)
                daemons.wait_for(lambda: daemons.state(file).get("mode") == "FAULT")
                time.sleep(SHOWN_S)
                album.shoot(fault)
                say(rig, "")
                time.sleep(1.0)
        if "bus_silent" in names:
            up(file)
            os.kill(rig.pid, signal.SIGSTOP)
            daemons.wait_for(lambda: daemons.state(file).get("mode") == "FAULT")
            time.sleep(SHOWN_S)
            album.shoot("bus_silent")
            os.kill(rig.pid, signal.SIGCONT)
        if "loop_stopped" in names:
            up(file)
            os.kill(stopped := daemons.process_with(control, daemons.name_of(file)), signal.SIGSTOP)
            time.sleep(SHOWN_S)
            album.shoot("loop_stopped")
            os.kill(stopped, signal.SIGCONT)


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_shots", description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, metavar="DIR", help="where the pictures go")
    parser.add_argument("--everywhere", action="store_true", help="on tablets and a phone and in the dark theme too")
    parser.add_argument("--only", choices=NAMES, nargs="+", default=NAMES, metavar="NAME", help=", ".join(NAMES))
    options = parser.parse_args()
    if subprocess.run([ROOT / "tests/guest/apt", *BROWSER_PACKAGES], check=False).returncode:
        sys.exit(1)  # it has said what is missing
    options.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="rigctl-page-") as work:
        play(options.folder, pathlib.Path(work), options.everywhere, options.only)
    print(f"{len(list(options.folder.glob('page-*.png')))} pictures in {options.folder}")


if __name__ == "__main__":
    main()
