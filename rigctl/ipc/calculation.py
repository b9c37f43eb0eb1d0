"""A calculation in a process of its own, whose libraries load slowly, so that its caller goes on publishing.

The module is run as ``python -m MODULE RUNTIME_DIR WHAT < DATA`` and answers one line of JSON: its result, or
``{"refused": "why, in one line"}``, with a ``reason`` where its caller has kinds of them.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import msgspec

from rigctl.ipc.runtime_folder import Runtime

LIMIT_S = 60.0  # a busy computer takes 35 s, most of it for python-control to load; the client waits longer


def calculate(
    runtime: Runtime, module: str, what: str, data: bytes, *, done: tuple[str, str], refusal: type[ValueError]
) -> dict[str, Any]:
    """The answer of a module in another process.

    Args:
        runtime: folder of the running daemon; the process may open it.
        module: to run.
        what: its second argument.
        data: for its standard input.
        done: what it does, for a message: ``("the gains", "judged")``.
        refusal: raised, with why in one line.

    Raises:
        ValueError: as ``refusal``: the calculation refused its data, or gave no answer.
    """
    command = [sys.executable, "-m", module, str(runtime.directory), what]
    subject, verb = done
    try:
        ended = subprocess.run(
            command, input=data, stdout=subprocess.PIPE, timeout=LIMIT_S, check=True, pass_fds=runtime.descriptors
        )
        answer: dict[str, Any] = msgspec.json.decode(ended.stdout)
    except subprocess.TimeoutExpired:
        raise refusal(f"{subject} were not {verb} within {LIMIT_S:g} s") from None
    except (subprocess.SubprocessError, OSError, msgspec.MsgspecError) as error:
        raise refusal(f"{subject} could not be {verb}: {type(error).__name__}") from None
    if "refused" in answer:
        raise refusal(str(answer["refused"]), *([answer["reason"]] if "reason" in answer else []))
    return answer
