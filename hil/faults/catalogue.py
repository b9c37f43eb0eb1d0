"""The catalogue: every fault as one row of a table, with the reaction expected in every mode it can occur in.

The expectation follows from what carries the load, not from the loop's code: any loss of a sensor, of the bus or of
a process ends with the stroke held, latched; a drive that disobeys loses its power and its brake holds; disturbances
of a healthy rig are ridden through within a bound on the true tension.
"""

from __future__ import annotations

from hil.faults.rows import rows_parked
from hil.faults.rows.rows_alone import ALONE
from hil.faults.rows.rows_brake import BRAKE
from hil.faults.rows.rows_bus import BUS
from hil.faults.rows.rows_commands import COMMANDS
from hil.faults.rows.rows_creep import CREEP
from hil.faults.rows.rows_drive import DRIVE, DRIVE_FEEDBACK, SUPERVISION
from hil.faults.rows.rows_io import IO, RAIL_ENCODER
from hil.faults.rows.rows_plant import CONTROLLER, PLANT
from hil.faults.rows.rows_probe import PROBE
from hil.faults.rows.rows_rigs import RIGS
from hil.faults.rows.rows_second_force import SECOND_FORCE
from hil.faults.rows.rows_sensors import SENSOR_CELL, SENSOR_SLOPE
from hil.faults.rows.rows_turn import AFTER, INSIDE

CATALOGUE = (
    *SENSOR_CELL, *SENSOR_SLOPE, *IO, *RAIL_ENCODER, *SECOND_FORCE,
    *DRIVE_FEEDBACK, *BUS, *COMMANDS, *SUPERVISION, *DRIVE, *BRAKE, *CREEP, *PROBE, *PLANT, *CONTROLLER,
    *RIGS, *INSIDE, *AFTER, *ALONE,
)  # fmt: skip
"""Faults that simulated time can show; `hil.faults.processes` has the faults of real processes."""
BY_ID = {fault.id: fault for fault in CATALOGUE}
PARKED = {
    fault.id: row for fault in CATALOGUE if fault not in (*BRAKE, *ALONE) and (row := rows_parked.of(fault)) is not None
}
"""By the id of the fault: its row with the load on the brake. The rows of `BRAKE` and `ALONE` do that themselves."""
ROWS = BY_ID | {row.id: row for row in PARKED.values()}
