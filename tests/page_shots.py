"""``python -m tests.page_shots DIR [--everywhere] [--composed] [--only NAME...]``: the page in 4 modes and 8 faults.

A real daemon on the simulated rig, whose devices are made to fail one after the other; ``--composed``: the page's own
server with states as the gateway words them, for a computer too busy for a loop in real time. Each picture must answer
by itself: is it safe to walk in, why did it stop, what do I do, how long has it been so, which limit and which value.
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
from typing import Any

from PIL import Image
from playwright.sync_api import Browser

from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Event, Mode
from tests.builders import daemons
from tests.builders.exclusions import contradictions
from tests.builders.page_states import LOCK_OUT, Shown, charted, event, page_of, picture_of, state, tripped
from tests.builders.pages import PATIENT, Server, browser, look, serving
from tests.builders.paths import ROOT
from tests.builders.waiting import until

BROWSER_PACKAGES = ("chromium", "fonts-dejavu-core")
SIZE = (1920, 1080, "light")
ELSEWHERE = ((1440, 900, "light"), (1024, 768, "light"), (390, 844, "light"), (1920, 1080, "dark"))
RIG = "gravity_rig"
FAULTS = ("e_stop", "cell_silent", "cell_high", "rope_lost", "drive_trips", "runs_away")
# Slow motion and few status frames: the pictures may be taken on a busy computer.
SLOW = {"cylinder": {**PATIENT["cylinder"], "status_rate_hz": 5}, "tension": {"ramp_n_s": 10.0},
        "safety": {**PATIENT["safety"], "lock_out": LOCK_OUT}}  # fmt: skip
TRIES = 5
COLOURS = 96  # of a picture: a third of the size, and no difference to be seen
SHOWN_S = 4.0  # a fault is active for some seconds, so that "since when" says something


@contextlib.contextmanager
def faulty_rig(file: pathlib.Path, log: pathlib.Path) -> Iterator[subprocess.Popen[str]]:
    """The served rig, with its standard input for faults."""
    with log.open("wb") as out:
        child = subprocess.Popen(
            [sys.executable, "-m", "tests.builders.faulty_rig", str(file)],
            stdin=subprocess.PIPE, stdout=out, stderr=subprocess.STDOUT, text=True, cwd=ROOT,
        )  # fmt: skip
    try:
        until(lambda: child.poll() is not None or b"serving" in log.read_bytes(), log=log)
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

    def __init__(self, chromium: Browser, server: Server | Addressed, folder: pathlib.Path, everywhere: bool) -> None:
        self.chromium, self.server, self.folder, self.everywhere = chromium, server, folder, everywhere
        self.wrong: list[str] = []
        """Statements of one picture that contradict each other, by the table of exclusions."""

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
            lines = [" ".join(line.split()) for line in str(seen.run("document.body.innerText")).splitlines()]
            if wrong := contradictions([line for line in lines if line]):
                self.wrong.append(f"{name}: {wrong}")
            print(f"{name}: {shown}; {seen.errors}; {wrong}", flush=True)
            seen.page.close()
        return shown


def rigctl(file: pathlib.Path, *verb: str) -> str:
    """A command of the operator; its answer is printed, and returned."""
    answer = daemons.rigctl(*verb, file=file)
    said = (answer.stdout or answer.stderr).strip()
    print(said, flush=True)
    return said


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
            if "reset clears it" in rigctl(file, "arm"):  # the drive is in fault since a loop that has ended
                rigctl(file, "reset")
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
    file = daemons.rig_file(work, {**PATIENT, **SLOW}, rig=RIG)
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
                until(lambda: daemons.state(file).get("mode") == "FAULT")
                time.sleep(SHOWN_S)
                album.shoot(fault)
                say(rig, "")
                time.sleep(1.0)
        if "bus_silent" in names:
            up(file)
            os.kill(rig.pid, signal.SIGSTOP)
            until(lambda: daemons.state(file).get("mode") == "FAULT")
            time.sleep(SHOWN_S)
            album.shoot("bus_silent")
            os.kill(rig.pid, signal.SIGCONT)
        if "loop_stopped" in names:
            up(file)
            os.kill(stopped := daemons.process_with(control, daemons.name_of(file)), signal.SIGSTOP)
            time.sleep(1.0)  # a loop that hangs is replaced within 10 s
            album.shoot("loop_stopped")
            with contextlib.suppress(ProcessLookupError):  # the supervisor has replaced it
                os.kill(stopped, signal.SIGCONT)
        if album.wrong:
            sys.exit("\n".join(album.wrong))


_TRIPS = {
    "e_stop": Fault.E_STOP, "cell_silent": Fault.CELL_STALE, "cell_high": Fault.TENSION_HIGH,
    "rope_lost": Fault.CELL_STUCK, "drive_trips": Fault.DRIVE_FAULT, "runs_away": Fault.DRIVE_NOT_FOLLOWING,
    "bus_silent": Fault.BUS_SILENT,
}  # fmt: skip


def composed(name: str) -> Shown:
    """The state of a picture, as the gateway words it."""
    if name in _TRIPS:
        fault = _TRIPS[name]
        high: dict[str, Any] = {"tension_n": 450.1, "vertical_n": 450.1} if name == "cell_high" else {}
        high |= {"tension_n": 0.0, "vertical_n": 0.0} if name == "rope_lost" else {}
        return Shown(name, state(Mode.FAULT, fault=fault, rig=RIG, **high), tripped(fault))
    if name == "loop_stopped":
        stopped = {"loop_alive": False, "age_ms": 4300.0, "wall_ns": time.time_ns() - 4_300_000_000}
        return Shown(name, state(Mode.COMPENSATING, rig=RIG) | stopped)
    mode = Mode[name.upper()]
    slack: dict[str, Any] = {"tension_n": 0.2, "vertical_n": 0.2, "stroke_mm": 1.05, "speed_mm_s": 0.0}
    rising: dict[str, Any] = {"tension_n": 143.2, "vertical_n": 143.2, "stroke_mm": 25.4, "speed_mm_s": 1.7}
    more = {Mode.DISARMED: slack, Mode.HOLD: slack, Mode.TENSIONING: rising}.get(mode, {})
    began = {Mode.HOLD: (Mode.RELEASING, Event.SLACK), Mode.TENSIONING: (Mode.HOLD, Event.TENSION),
             Mode.COMPENSATING: (Mode.TENSIONING, Event.TENSIONED)}.get(mode)  # fmt: skip
    events = [event(Kind.MODE, -14.0, began[0], mode, float(began[1]))] if began else [event(Kind.STARTED, -30.0)]
    return Shown(name, state(mode, rig=RIG, **more), [taken(-60.0), *events])


def taken(at_s: float) -> dict[str, Any]:
    """The gateway's note of a lease taken."""
    return event(Kind.STARTED, at_s) | {"source": "gateway", "kind": "LEASE_TAKEN", "operator": "kim",
                                        "text": "kim takes the lease"}  # fmt: skip


def compose(folder: pathlib.Path, everywhere: bool, names: Collection[str]) -> None:
    """The pictures without a loop in real time."""
    with browser() as chromium:
        for name in names:
            picture = picture_of(composed(name))
            charted(picture)
            with page_of(picture) as address:
                album = Album(chromium, Addressed(address), folder, everywhere)
                album.shoot(name)
            if album.wrong:
                sys.exit("\n".join(album.wrong))


class Addressed:
    """A page server by its addresses alone."""

    def __init__(self, link: Callable[[], str]) -> None:
        self._link = link

    @property
    def address(self) -> str:
        """An address that an operator opens, with a link of its own."""
        return self._link()


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_shots", description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, metavar="DIR", help="where the pictures go")
    parser.add_argument("--everywhere", action="store_true", help="on tablets and a phone and in the dark theme too")
    parser.add_argument("--composed", action="store_true", help="states as the gateway words them, without a loop")
    parser.add_argument("--only", choices=NAMES, nargs="+", default=NAMES, metavar="NAME", help=", ".join(NAMES))
    options = parser.parse_args()
    if subprocess.run([ROOT / "tests/guest/apt", *BROWSER_PACKAGES], check=False).returncode:
        sys.exit(1)  # it has said what is missing
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.composed:
        compose(options.folder, options.everywhere, options.only)
    else:
        with tempfile.TemporaryDirectory(prefix="rigctl-page-") as work:
            play(options.folder, pathlib.Path(work), options.everywhere, options.only)
    print(f"{len(list(options.folder.glob('page-*.png')))} pictures in {options.folder}")


if __name__ == "__main__":
    main()
