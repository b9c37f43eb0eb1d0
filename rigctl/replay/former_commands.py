"""Commands of recordings that were made while a slot of the command ring had one value, as slots of today."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from rigctl.control.modes import Setting, command_slot
from rigctl.ipc.record import COMMAND

_GAINS = (131, 132, 133)  # came one by one in this order; the last put the whole set in force


def as_of_today(commands: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """The same commands with a field for each value.

    A gain that completes no set keeps its former code, which the loop refuses as it refused or only kept that gain.
    """
    if "value" not in (commands.dtype.names or ()):
        return commands
    made = np.empty(len(commands), COMMAND.dtype)
    gains: list[float] = []
    for i, slot in enumerate(commands):
        seq, t_ns, id_, code, value = (slot[name].item() for name in ("seq", "t_ns", "id", "verb", "value"))
        values = [value]
        if code in _GAINS:
            place = _GAINS.index(code)
            valid = math.isfinite(value) and value >= 0.0 and place <= len(gains)
            gains = [*gains[:place], value] if valid else []
            if len(gains) == len(_GAINS):
                code, values, gains = int(Setting.LAW_GAINS), gains, []
        made[i] = (seq, *command_slot(t_ns, id_, code, *values))
    return made
