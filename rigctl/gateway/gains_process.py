"""``python -m rigctl.gateway.gains_process RUNTIME_DIR NAME < GAIN_FILE``: judges gains for a running rig.

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
from rigctl.operations.gain_admission import NotAdmittedError, admitted


def admit(runtime: Runtime, text: str, name: str) -> dict[str, Any]:
    """`admitted` for the daemon in this folder, in another process.

    Raises:
        NotAdmittedError: see there.
    """
    answer = calculate(
        runtime, "rigctl.gateway.gains_process", name, text.encode(), done=("the gains", "judged"),
        refusal=NotAdmittedError,
    )  # fmt: skip
    return dict(answer["design"])


def _judge(directory: str, name: str, text: bytes) -> dict[str, Any]:
    try:
        settings = RigSettings.model_validate(Runtime(directory).read_json("active.json").get("settings"))
    except (OSError, msgspec.MsgspecError, ValidationError):
        return {"refused": "active.json holds no valid settings to judge the gains by"}
    try:
        return {"design": admitted(settings, text.decode(), name)}
    except NotAdmittedError as error:
        return {"refused": str(error)}
    except UnicodeDecodeError as error:
        return {"refused": " ".join(str(error).split())}


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(_judge(sys.argv[1], sys.argv[2], sys.stdin.buffer.read())))
