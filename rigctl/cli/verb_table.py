"""Every command of ``rigctl``: its name, where it is, and its line of ``rigctl --help``.

A command loads its own module only, and ``rigctl --help`` none of them. The line is the first sentence of the command's
docstring, which a test holds it to.
"""

from __future__ import annotations

from typing import NamedTuple


class VerbRow(NamedTuple):
    """``place``: ``MODULE:NAME`` below ``rigctl.cli``, a function or a ``typer.Typer`` with commands of its own.

    ``signed``: it takes a negative number as a value, not as an option. ``json_file``: its ``--json`` takes a file too.
    """

    name: str
    place: str
    line: str
    signed: bool = False
    json_file: bool = False


GROUPS: dict[str, tuple[VerbRow, ...]] = {
    "Watch": (
        VerbRow(
            "status",
            "status:status",
            "Show mode, what holds the load, what is wrong, what to do next, alarms and tension.",
        ),
        VerbRow("watch", "watch:watch", "Follow the rig; Ctrl-C ends."),
        VerbRow(
            "alarms",
            "alarms:alarms",
            "Show the alarms, acknowledge one or all, or shelve one; every display of the rig follows.",
        ),
        VerbRow(
            "page",
            "page:page",
            "Serve the live page until Ctrl-C: charts, mode, limits, events; read-only unless --operator is given.",
        ),
        VerbRow(
            "bridge",
            "bridge:bridge",
            "Serve a running rig to other tools, read-only, until Ctrl-C; waits for a daemon.",
        ),
    ),
    "Command": (
        VerbRow("lease", "lease:lease", "Show who may command the rig; take that over, or give it back."),
        VerbRow("arm", "verbs:arm", "Drive on, brake open, stroke held: DISARMED to HOLD."),
        VerbRow("tension", "verbs:tension", "Ramp to the target and hold it: TENSIONING, then COMPENSATING."),
        VerbRow("target", "verbs:target", "Set the vertical tension to hold.", signed=True),
        VerbRow(
            "move",
            "verbs:move",
            "A move of the mechanism begins now: play what was learnt from it, and learn from it; 0: it has ended.",
        ),
        VerbRow("release", "verbs:release", "Ramp to a slack rope, then HOLD; or pay out MM of a slack rope."),
        VerbRow("disarm", "verbs:disarm", "Drive off, brake closed."),
        VerbRow("hold", "hold:hold", "Stop and hold the stroke where it is."),
        VerbRow("reset", "verbs:reset", "Acknowledge a fault whose cause is gone."),
        VerbRow(
            "confirm-stroke",
            "verbs:confirm_stroke",
            "Confirm the stroke after the drive's position was lost or differs from the last one known.",
            signed=True,
        ),
        VerbRow(
            "carry",
            "verbs:carry",
            "Where the brake does not hold: the motor holds the load for SECONDS, then lowers it.",
            signed=True,
        ),
        VerbRow("lower", "verbs:lower", "Where the brake does not hold: the motor lowers the load to a slack rope."),
        VerbRow(
            "brake-test",
            "verbs:brake_test",
            "Where the brake is known not to hold: it has the load for 10 s, then the motor; shows that it holds.",
        ),
    ),
    "Commission": (
        VerbRow(
            "check",
            "run:check",
            "Validate a rig file and its design; show the resolved rig and the worst-case load of its bus.",
        ),
        VerbRow(
            "tune",
            "tune:tune",
            "Compute gains for a rig; show and judge their margins over the family of plants.",
            json_file=True,
        ),
        VerbRow(
            "tare",
            "commission:tare",
            "Make the unloaded cell read zero; within calibration.tare_limit_n, and on record.",
        ),
        VerbRow(
            "calibrate",
            "commission:calibrate",
            "Hold the cell against a known weight that hangs still, or against the shunt; on record, with a due date.",
        ),
        VerbRow(
            "identify",
            "commission:identify",
            "Small motions of the stroke tell lag, delay, stiffness and more; proposes, and changes nothing.",
        ),
        VerbRow(
            "gains",
            "commission:gains",
            "Act by the gains of a file from `rigctl tune --gains` from now on, in any mode, without a step.",
        ),
    ),
    "Record": (
        VerbRow(
            "note",
            "note:note",
            "Put words on record with the run: an event, an entry of the audit log, a line of runs and of the report.",
        ),
        VerbRow(
            "runs",
            "runs:runs",
            "List the runs that are recorded and the trip dumps: number, start, duration, trips, notes.",
        ),
        VerbRow("audit", "audit:audit", "Verify the audit log's chain of hashes, or show what is in it."),
        VerbRow(
            "info",
            "recordings:info",
            "Show what is in a recording: times, modes, events, gaps, documents, versions, and whether it is complete.",
        ),
        VerbRow(
            "replay",
            "replay:replay",
            "Play a recording through the loop again: every command and mode bit-identical, or the first that is not.",
        ),
        VerbRow("report", "report:report", "Write a test report of a recording: verdict, charts, provenance."),
        VerbRow(
            "export",
            "recordings:export",
            "Write a recording as Parquet, CSV, MAT or MDF4: a new folder with a table for each topic, units included.",
        ),
    ),
    "Run and install": (
        VerbRow("run", "run:run", "Run the daemon until SIGTERM, SIGHUP or Ctrl-C; it ends with the stroke held."),
        VerbRow(
            "demo",
            "run:demo",
            "Play the paper's move on the simulated rig and judge it by the rig file's own limits.",
            json_file=True,
        ),
        VerbRow(
            "doctor",
            "doctor:doctor",
            "Run the preflight without arming, and look at the computer: ok, warning or fails, and what to do.",
        ),
        VerbRow(
            "bench",
            "bench:bench",
            "Measure how well this computer keeps the loop's time, on the simulated rig; the real one is not touched.",
        ),
        VerbRow("keys", "keys:keys", "Make the rig's keys: who may watch, command, calibrate over the network."),
        VerbRow(
            "install",
            "install:install",
            "Install a rig as services: settings to /etc/rigctl, units, CAN interface; data are kept.",
        ),
        VerbRow(
            "uninstall",
            "install:uninstall",
            "Stop a rig's services and remove what install wrote; its settings and data stay.",
        ),
    ),
}
"""The commands as ``rigctl --help`` shows them, by what a person is about to do."""
VERBS = tuple(row for rows in GROUPS.values() for row in rows)


def row_of(name: str) -> VerbRow | None:
    """The row of a command."""
    return next((row for row in VERBS if row.name == name), None)
