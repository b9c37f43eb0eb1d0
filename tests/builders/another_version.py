"""A daemon of another version: the real gateway on a record with more fields. ``... RUNTIME_DIR [SCHEMA_VERSION]``.

Between the known fields there are an array and a field of a type that no numpy version knows yet.
"""

from __future__ import annotations

import pathlib
import sys
import threading
import time
from typing import Any

import numpy as np

from rigctl.ipc import record
from rigctl.ipc.record import Field, Slot


class Newer(Slot):
    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype([(name, *(kind,)) for name, kind in self._kinds()])

    def _kinds(self) -> list[tuple[str, str]]:
        return [(name, kind.str) for name, (kind, *_) in (super().dtype.fields or {}).items()]


def main() -> None:
    fields = list(record.RECORD.fields)
    at = [field.name for field in fields].index("tension_n")
    fields[at:at] = [Field("gusts_mm_s", "d", "mm/s", "new in that version"), Field("tag", "8s", "", "new too")]
    record.RECORD = Newer("record", tuple(fields))

    from rigctl.config.settings import RigSettings
    from rigctl.gateway import gateway_process as gateway
    from rigctl.ipc.runtime_folder import Runtime
    from rigctl.wire import schema

    runtime = Runtime(pathlib.Path(sys.argv[1]))
    if len(sys.argv) > 2:
        schema.VERSION = int(sys.argv[2])
    served = schema.schema

    def with_unknown_type(rig: str, person: str = "") -> dict[str, Any]:
        found = served(rig, person)
        for field in found["fast"]["record"]["fields"]:
            if field["name"] == "tag":
                field["type"] = "<decimal64"
        return found

    gateway.schema = with_unknown_type  # type: ignore[attr-defined]
    runtime.make_rings(RigSettings.model_validate(runtime.read_json("active.json")["settings"]))
    writer = runtime.records.writer()
    names = [field.name for field in fields]

    def write() -> None:
        for tick in range(1_000_000):
            values: dict[str, Any] = dict.fromkeys(names, 0) | {
                "t_ns": time.monotonic_ns(), "tick": tick, "tag": b"x", "tension_n": 300.0, "gusts_mm_s": tick / 2,
            }  # fmt: skip
            writer.write(*values.values())
            time.sleep(0.001)

    threading.Thread(target=write, daemon=True).start()
    raise SystemExit(gateway.main([sys.argv[1]]))


if __name__ == "__main__":
    main()
