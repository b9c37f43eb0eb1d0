"""``python -m tests.soak [--for 8h] [--seed N] [--service RIG] [--json F] [--plot F]``: a day in service, judged.

Exit code 0: every promise held; 1: one line for each that was broken; 2: wrong usage.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import secrets
import sys
import tempfile

from tests.soak import picture, plan, subject
from tests.soak.run import Soak


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    """Run the soak; returns the exit code."""
    parser = argparse.ArgumentParser(description="A day in service on the simulated rig, judged by promises.")
    parser.add_argument("--for", dest="duration", default="1h", metavar="TIME", help="e.g. 120s, 10m, 8h [1h]")
    parser.add_argument("--seed", type=int, default=None, help="of everything random [another each time]")
    parser.add_argument("--json", type=pathlib.Path, default=pathlib.Path("results/soak.json"), metavar="FILE")
    parser.add_argument("--plot", type=pathlib.Path, default=pathlib.Path("results/soak.png"), metavar="FILE")
    parser.add_argument(
        "--service", metavar="RIG", help="soak the services of this installed rig, as root, and stop them"
    )
    arguments = parser.parse_args()
    try:
        duration_s = plan.seconds(arguments.duration)
    except ValueError as error:
        sys.stderr.write(f"soak: --for: {error}\n")
        return 2
    seed = secrets.randbelow(10**6) if arguments.seed is None else arguments.seed
    say(f"soak: {duration_s:.0f} s, seed {seed} (--seed {seed} plays the same again)")
    with tempfile.TemporaryDirectory(prefix="rigctl-soak-") as folder:
        try:
            with (
                subject.installed(arguments.service) if arguments.service else subject.own(pathlib.Path(folder)) as one
            ):
                results, slopes, processes = Soak(duration_s, seed, say).run(one)
        except subject.SubjectError as error:
            sys.stderr.write(f"soak: --service: {error}\n")
            return 2
    for file in (arguments.json, arguments.plot):
        file.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    picture.draw(results, processes, arguments.plot)
    for fit in slopes:
        say(
            f"{fit.name:<10} {fit.minutes:6.1f} min  {fit.memory_mib:7.1f} MiB  grows {fit.memory_grows_mib:+6.2f} "
            f"(allowed {fit.memory_allowed_mib:.2f})  {fit.handles:4.0f} handles  grow {fit.handles_grow:+.1f}"
        )
    for kind, figures in results["lateness"].items():
        say(f"lateness {kind:<6} " + "  ".join(f"{name} {value:g}" for name, value in figures.items()))
    say(f"{results['records']} records, lost: {results['lost']}")
    if results["overwritten"]:
        say(f"{results['overwritten']} more were overwritten in the ring before a killed gateway was back")
    say(f"commands {results['commands']}, clients {results['clients_came']}, page frames {results['page']['frames']}")
    pauses = results["pauses"]
    say(f"pauses of the computer: {pauses['count']}, the longest {pauses['longest_ms']:.0f} ms")
    say(f"strikes {len(results['strikes'])}, trips {len(results['trips'])}")
    for trip in results["trips"]:
        say(f"  {trip['text'].partition(':')[0]}: {trip['cause'] or 'NO CAUSE'}")
    for line in results["broken"]:
        sys.stderr.write(f"soak: {line}\n")
    return 1 if results["broken"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
