"""``python -m tests.fuzz [frames|commands|configs|replies|startup|device-files|all]``: random input at every entry.

frames: into the loop, every frame it sends judged. commands: queries through the parsers into the loop. configs: rig
files, and every other kind of file. replies: SDO answers to the start-up. startup: every file read at a start, damaged
or replaced. device-files: EDS and DBC files as the field has them, checked and started. Exit code 0 good, 1 a finding,
2 usage.
"""

from __future__ import annotations

import argparse
import json
import logging
import pathlib
import sys
import time
from collections.abc import Callable
from typing import Any

from rigctl.config import rig_file as config
from rigctl.design.margins import design_and_check
from tests.builders.paths import ROOT
from tests.fuzz import commands, device_files, files, frames, replies, startup_files
from tests.fuzz.judge import Tally

COUNTS = {"frames": 1_000_000, "commands": 10_000, "configs": 10_000, "replies": 500, "startup": 1000,
          "device-files": 60}  # fmt: skip
SHOWN = 20


def run(what: str, count: int, seed: int) -> dict[str, Any]:
    """Run one of them; returns its figures."""
    settings = config.load(ROOT / "config/paper_rig.yaml")
    gains = design_and_check(settings).gains
    started = time.monotonic()
    kinds: dict[str, Callable[[], Tally | frames.Found]] = {
        "frames": lambda: frames.play(settings, gains, count, seed),
        "commands": lambda: commands.play(settings, gains, count, seed),
        "configs": lambda: files.play(count, max(1, count // 10), max(1, count // 100), seed),
        "replies": lambda: replies.play(settings, count, seed),
        "startup": lambda: startup_files.play(count, seed),
        "device-files": lambda: device_files.play(count, seed),
    }
    found = kinds[what]()
    if isinstance(found, Tally):
        figures: dict[str, Any] = {"tried": dict(found.tried), "taken": dict(found.taken)}
    else:
        figures = {"tried": {"frame": found.frames, "command": found.commands}, "ticks": found.ticks,
                   "modes": sorted(found.modes), "faults": sorted(found.faults - {"NONE"})}  # fmt: skip
    seconds = round(time.monotonic() - started, 1)
    return {"ok": not found.wrong, "seed": seed, "seconds": seconds, **figures, "wrong": found.wrong}


def show(what: str, said: dict[str, Any]) -> None:
    """Print the figures as a few lines."""
    print(f"{what}: {'good' if said['ok'] else 'WRONG'}, {said['seconds']:g} s")
    for name, count in said["tried"].items():
        taken = said.get("taken", {}).get(name)
        print(f"  {name:28s}{count:10d}{f'{taken:10d} taken' if taken is not None else ''}")
    for name in ("modes", "faults"):
        if name in said:
            print(f"  {name} seen: {', '.join(said[name])}")
    for wrong in said["wrong"][:SHOWN]:
        print(f"  WRONG {wrong}")
    if len(said["wrong"]) > SHOWN:
        print(f"  ... {len(said['wrong']) - SHOWN} more")


def main() -> int:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("what", nargs="?", default="all", choices=(*COUNTS, "all"))
    parser.add_argument("--count", type=int, help="instead of " + ", ".join(f"{v} {k}" for k, v in COUNTS.items()))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=pathlib.Path, metavar="F", help="write the figures there")
    asked = parser.parse_args()
    if asked.count is not None and asked.count < 1:
        parser.error(f"--count: found {asked.count}, expected 1 or more")
    logging.disable(logging.CRITICAL)  # canopen's warnings of invalid responses
    said = {}
    for what in COUNTS if asked.what == "all" else (asked.what,):
        said[what] = run(what, asked.count or COUNTS[what], asked.seed)
        show(what, said[what])
    good = all(each["ok"] for each in said.values())
    if asked.json is not None:
        try:
            asked.json.write_text(json.dumps({"ok": good, **said}, indent=1) + "\n")
        except OSError as error:
            parser.error(f"--json: {asked.json} cannot be written: {error.strerror}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
