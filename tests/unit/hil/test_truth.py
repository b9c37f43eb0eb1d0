"""The truth log: written once per millisecond, readable after any end."""

from __future__ import annotations

import pathlib

from hil.truth import TRUTH_DTYPE, TruthLog, read
from tests.builders.rig_bench import MS, RigBench


def test_the_rig_logs_every_millisecond(tmp_path: pathlib.Path) -> None:
    log = TruthLog(tmp_path / "truth.bin")
    bench = RigBench(truth_log=log)
    bench.rig.start_motion()
    for t_ns in (300_000, 5 * MS, 5 * MS + 1, 1234 * MS):
        bench.rig.advance(t_ns)
    log.close()
    records = read(tmp_path / "truth.bin")
    assert records["t_ns"].tolist() == [i * MS for i in range(1, 1235)]
    assert records["moving"].all()
    last = bench.rig.truth
    assert records[-1].tolist() == tuple(last)


def test_a_second_of_records_is_on_disk_without_closing(tmp_path: pathlib.Path) -> None:
    log = TruthLog(tmp_path / "truth.bin")
    RigBench(truth_log=log).wait(1000)
    assert len(read(tmp_path / "truth.bin")) == 1000
    log.close()


def test_a_record_cut_short_is_left_out(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "truth.bin"
    file.write_bytes(bytes(TRUTH_DTYPE.itemsize * 3 + 5))
    assert len(read(file)) == 3
