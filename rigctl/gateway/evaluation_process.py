"""``python -m rigctl.gateway.evaluation_process RUNTIME_DIR WHAT < RECORDS``: evaluates the records of a multisine.

It is a process of its own because the design's libraries load slowly and the gateway must go on publishing. RECORDS are
columns of `rigctl.gateway.excited_records` in NumPy's format. WHAT is response or margins. It answers one line of JSON:
what the function of that name in `rigctl.operations.evaluation` returns, or ``{"refused": "why, in one line"}``.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from rigctl.commission.identification import IdentificationError
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.ipc.calculation import calculate
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.model.unmeasured import Unmeasured
from rigctl.operations.evaluation import EvaluationError, margins, response


def evaluate(runtime: Runtime, what: str, records: npt.NDArray[Any]) -> dict[str, Any]:
    """`response` or `margins` of the daemon in this folder, in another process.

    Raises:
        EvaluationError: see there.
    """
    data = io.BytesIO()
    np.save(data, records, allow_pickle=False)
    return calculate(
        runtime, "rigctl.gateway.evaluation_process", what, data.getvalue(), done=("the records", "evaluated"),
        refusal=EvaluationError,
    )  # fmt: skip


_WHAT: dict[str, Callable[[RigSettings, Gains, npt.NDArray[Any]], dict[str, Any]]] = {
    "response": response, "margins": margins,
}  # fmt: skip


def _evaluate(directory: str, what: str, data: bytes) -> dict[str, Any]:
    from rigctl.design.gains import DesignError

    runtime = Runtime(directory)
    try:
        active = runtime.read_json(ACTIVE)
        settings, gains = RigSettings.model_validate(active.get("settings")), Gains(**active["design"]["gains"])
    except (OSError, msgspec.MsgspecError, ValidationError, KeyError, TypeError):
        return {"refused": "active.json holds no valid settings and gains to evaluate by"}
    try:
        return _WHAT[what](settings, gains, np.load(io.BytesIO(data), allow_pickle=False))
    except (IdentificationError, DesignError, ArithmeticError, ValueError) as error:  # the others: no plant has these
        reason = error.reason if isinstance(error, IdentificationError) else Unmeasured.OTHER
        return {"refused": " ".join(str(error).split()), "reason": reason}


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(_evaluate(sys.argv[1], sys.argv[2], sys.stdin.buffer.read())))
