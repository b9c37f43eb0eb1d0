"""Everything the page shows of the rig. The reader's thread writes it, the server's thread reads it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.client.rig_view import RigView
from rigctl.page.chart_signals import values_of
from rigctl.page.history import History, Ids
from rigctl.page.lateness import Lateness


class Picture(RigView):
    """The view of the rig, with the charts' history and the state of the connection."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.history = History()
        self.lateness = Lateness()
        self.samples_lost = 0  # of the fast stream, between gateway and page
        self.trouble = f"no daemon has answered at {endpoint} yet"  # why no data comes

    def add_records(self, records: npt.NDArray[Any], wall_offset_ns: int) -> None:
        """Add records of the fast stream; ``wall_offset_ns``: wall clock less the records' clock."""
        wall_ns: Ids = records["t_ns"].astype(np.int64) + wall_offset_ns
        values = values_of(records)
        with self.lock:
            self.history.add(wall_ns, values)
            self.lateness.add(wall_ns, records)
