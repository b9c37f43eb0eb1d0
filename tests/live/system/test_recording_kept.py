"""The recording of a real daemon: complete while its recorder is killed, and while its disk is full."""

from __future__ import annotations

import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from rigctl.config import rig_file as config
from rigctl.ipc.runtime_folder import RECORDED, Runtime
from rigctl.model.states import Mode
from rigctl.recorder import recording
from tests.bench.recorder import PATIENT, judged, strike
from tests.builders import daemons
from tests.builders.operators import ANNA
from tests.builders.waiting import patience_s, until

KILLS = 3


def test_a_session_with_kills_is_recorded_whole(tmp_path: pathlib.Path) -> None:
    file, log = daemons.rig_file(tmp_path, PATIENT), tmp_path / "daemon.log"
    chance = random.Random(8)
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log) as daemon:
        runtime = Runtime.of(daemons.name_of(file))
        records, commands = runtime.records.reader(), runtime.commands.reader()
        assert daemons.rigctl("arm", "--operator", "anna", file=file).returncode == 0
        assert daemons.rigctl("target", "61.5", "--operator", "anna", file=file).returncode == 0
        struck = [strike(file, chance, 1.0) for _ in range(KILLS)]
        os.kill(daemons.process_with("rigctl.control", runtime.directory.name), signal.SIGKILL)
        until(lambda: log.read_text().count("node 4: operational") == 2, log=log)
        told = until(lambda: runtime.read_json(RECORDED).get("recording"), log=log)
        assert told["records_lost"] == told["frames_lost"] == 0
        slots, given = records.read(), commands.read()
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(patience_s()) == 0

    settings = config.load(file)
    kills = judged(settings, struck)
    assert all(kill.readable for kill in kills)
    assert max(kill.lost_ms for kill in kills) == 0
    first = sorted((tmp_path / "recordings").iterdir())[0]
    found = recording.read(*recording.parts_of(first))
    assert len(found.files) == KILLS + 1
    assert [file.complete for file in found.files] == [False] * KILLS + [True]
    assert found.gaps == []
    assert found.records["seq"][0] == 1
    kept = found.records[np.isin(found.records["seq"], slots["seq"])]
    assert len(kept) == len(slots)
    for name in ("t_ns", "tick", "mode", "flags", "statusword", "controlword", "command_mm_s", "checks", "work_ns"):
        assert np.array_equal(kept[name], slots[name]), name
    assert np.array_equal(kept["tension_n"], slots["tension_n"].astype(np.float32), equal_nan=True)
    assert found.commands[np.isin(found.commands["seq"], given["seq"])].tobytes() == given.tobytes()
    assert 61.5 in found.commands["target_n"]

    # every counted frame of the loop that ran to its end is there
    first_ns, second_ns = found.control_starts
    last = found.records[-1]
    assert found.frames["sent"][found.frames["t_ns"] >= second_ns].sum() >= last["frames_sent"] - 20
    before, after = (json.loads(found.in_force("control.json", t_ns) or b"") for t_ns in (first_ns, second_ns))
    assert before["pid"] != after["pid"]
    assert json.loads(found.attachments["active.json"])["design"]["gains"]
    assert Mode.HOLD in found.records["mode"]
    what = [entry.what for entry in found.audit]
    assert what.count("daemon_started") == 1
    assert what.count("recorder_started") == KILLS + 1
    assert [entry.seq for entry in found.audit] == list(range(1, len(found.audit) + 1))
    assert (ANNA, "command_accepted") in [(entry.who, entry.what) for entry in found.audit]
    assert [event.seq for event in found.events] == list(range(1, len(found.events) + 1))

    with found.files[-1].path.open("rb") as stream:  # the last part with mcap's own reader
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        ticks = [item.decoded_message.tick for item in reader.iter_decoded_messages(topics=["/records"])]
    alone = recording.read(found.files[-1].path)
    assert ticks == alone.records["tick"].tolist()


@pytest.mark.skipif(os.getuid() != 0 or shutil.which("mount") is None, reason="needs root, to mount a small disk")
def test_a_full_disk_ends_the_recording_alone_and_it_comes_back_by_itself(tmp_path: pathlib.Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(disk)], check=True)
    try:
        changes: dict[str, dict[str, Any]] = {
            **PATIENT,
            "preflight": {"disk_free_mib": 1},
            "recording": {"folder": str(disk), "free_mib": 8},
        }
        file, log = daemons.rig_file(tmp_path, changes), tmp_path / "daemon.log"
        with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log) as daemon:
            runtime = Runtime.of(daemons.name_of(file))
            records = runtime.records.reader()

            def told() -> dict[str, object]:
                return dict(runtime.read_json(RECORDED).get("recording") or {})

            until(lambda: told().get("records"), log=log)
            filler = disk / "filler"
            with filler.open("wb", buffering=0) as out, pytest.raises(OSError, match="No space left"):
                while True:
                    out.write(b"x" * 4096)
            until(lambda: runtime.read_json(RECORDED)["warnings"], log=log)
            until(lambda: "loop is unaffected" in log.read_text(), log=log)

            def warned() -> bool:
                return any(text.startswith("recorder: ") for text in daemons.state(file).get("warnings", []))

            until(warned, log=log)  # the gateway reads the recorder's status at intervals
            assert daemons.mode(file) == "DISARMED"
            filler.unlink()
            until(lambda: told().get("file") and not runtime.read_json(RECORDED)["warnings"], log=log)
            slots = records.read()
            assert np.all(np.diff(slots["seq"]) == 1)
            assert runtime.read_json(RECORDED)["failures"] >= 1
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(patience_s()) == 0
        files = sorted(disk.glob("*.mcap"))
        found = recording.read(*files)
        assert found.records["seq"][0] == 1
        assert found.gaps == []  # the rings held the data of the meantime
        assert found.records["mode"][-1] == Mode.DISARMED
        assert found.files[-1].complete
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
