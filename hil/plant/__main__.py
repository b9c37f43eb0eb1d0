"""``python -m hil.plant``: compile the plant now, so that the first run does not wait for it."""

from __future__ import annotations

import sys
import time

from hil.plant.plant import compile_kernel


def main() -> None:
    """Compile; numba caches the compiled code beside the source."""
    start = time.perf_counter()
    compile_kernel()
    sys.stdout.write(f"plant compiled in {time.perf_counter() - start:.1f} s\n")


if __name__ == "__main__":
    main()
