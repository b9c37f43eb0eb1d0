"""``python -m rigctl.design.admission RUNTIME_DIR NAME < GAIN_FILE``: judges gains for a running rig.

It is a process of its own because the design's libraries load slowly and the gateway must go on publishing. It answers
one line of JSON: ``{"design": ...}`` as in ``active.json``, or ``{"refused": "why, in one line"}``.
"""

from __future__ import annotations

import sys
from typing import Any

import msgspec
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.ipc.calculation import calculate
from rigctl.ipc.runtime_folder import Runtime


class NotAdmittedError(ValueError):
    """The gains are refused; ``str()`` says why, in one line."""


def admit(runtime: Runtime, text: str, name: str) -> dict[str, Any]:
    """The design of a gain file on the running rig, as in ``active.json``.

    Raises:
        NotAdmittedError: it is not a gain file, not for this rig, or its margins are refused.
    """
    answer = calculate(
        runtime, "rigctl.design.admission", name, text.encode(), done=("the gains", "judged"), refusal=NotAdmittedError
    )
    return dict(answer["design"])


def _judge(directory: str, name: str, text: bytes) -> dict[str, Any]:
    from rigctl.design.gains import DesignError
    from rigctl.design.in_use import design_while_running  # imports python-control

    try:
        settings = RigSettings.model_validate(Runtime(directory).read_json("active.json").get("settings"))
    except (OSError, msgspec.MsgspecError, ValidationError):
        return {"refused": "active.json holds no valid settings to judge the gains by"}
    try:
        found = design_while_running(settings, text.decode(), name)
    except (DesignError, ArithmeticError, ValueError) as error:  # the others: numbers that no plant has
        return {"refused": " ".join(str(error).split())}
    return {"design": found.as_dict()} if found.accepted else {"refused": found.verdict()}


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(_judge(sys.argv[1], sys.argv[2], sys.stdin.buffer.read())))
