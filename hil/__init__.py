"""The simulated rig: plant, sensors, drive and bus, reached through CAN frames only."""

import rigctl  # noqa: F401 - before python-can, which would import asammdf and pandas with it
