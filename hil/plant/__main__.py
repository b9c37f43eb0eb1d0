"""``python -m hil.plant``: compile the plant now, so that the first run does not wait for it."""

from __future__ import annotations

import sys
import time

import numpy as np

from hil.plant import kernel
from hil.plant.inputs import pack
from hil.plant.layout import PARAMETERS, STATE, VIEW


def main() -> None:
    """Call every entry of the kernel once with no steps; numba caches the compiled code beside the source."""
    start = time.perf_counter()
    parameters, state, view = np.zeros(1, PARAMETERS), np.zeros(1, STATE), np.zeros(1, VIEW)
    for name in ("elements", "rope_length", "payload_mass"):
        parameters[name] = 1.0
    nodes, pulls, inputs = np.zeros((1, 4)), np.zeros((1, 2)), pack({})
    kernel.run(parameters, state, nodes, pulls, inputs, 0.0, 1e-4, 0, 0.0, True)
    kernel.observe(parameters, state, nodes, pulls, inputs, view, 0.0, 0.0, True)
    kernel.screw_error(parameters[0], 0.0)
    sys.stdout.write(f"plant compiled in {time.perf_counter() - start:.1f} s\n")


if __name__ == "__main__":
    main()
