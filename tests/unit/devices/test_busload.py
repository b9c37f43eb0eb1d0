"""The rates that the bus load is reckoned from."""

from __future__ import annotations

import pytest

from rigctl.config.changed_settings import changed
from rigctl.config.io_section import IoSettings
from rigctl.config.settings import RigSettings
from rigctl.devices import busload, sdo
from tests.builders.rig_bench import SETTINGS

FITTED = SETTINGS.model_copy(update={"io": IoSettings(e_stop_input=0, inhibit_ms=20)})


def test_every_frame_loads_the_bus_at_the_rate_at_which_it_comes() -> None:
    rates = {item.name: item.rate_hz for item in busload.traffic(FITTED)}
    loop_hz = FITTED.loop.rate_hz
    assert {name: rates[name] for name in ("SYNC", "command", "tension", "drive status")} == dict.fromkeys(
        ("SYNC", "command", "tension", "drive status"), loop_hz
    )
    assert rates["inclination"] == FITTED.inclinometer.rate_hz
    assert rates["I/O inputs"] == pytest.approx(50.0)
    assert rates["heartbeat, controller"] == pytest.approx(1000.0 / FITTED.can.heartbeat_ms)


def test_a_setting_is_read_back_with_a_request_and_an_answer() -> None:
    rates = {item.name: item.rate_hz for item in busload.traffic(FITTED)}
    asked_hz = FITTED.loop.rate_hz / sdo.every_ticks(FITTED)
    assert rates["settings read back, request"] == rates["settings read back, answer"] == asked_hz
    assert asked_hz <= sdo.READS_HZ


@pytest.mark.parametrize(
    ("bit_rate", "advice"),
    [
        (500_000, "loop.rate_hz 500 makes it 49.9%, can.bitrate_bit_s 800000 makes it 56.8%"),
        (20_000, "can.bitrate_bit_s 800000 makes it 56.8%"),  # no loop is slow enough
    ],
)
def test_an_overloaded_bus_says_what_would_do(bit_rate: int, advice: str) -> None:
    slow = changed(SETTINGS, {"can.bitrate_bit_s": bit_rate})
    assert (busload.bus_load(slow) or 0.0) > busload.LIMIT
    assert busload.advice(slow) == advice
    for part in advice.split(", "):
        key, value, *_ = part.split()
        better = busload.bus_load(RigSettings.model_validate(changed(slow, {key: int(value)}).model_dump()))
        assert better is not None
        assert better <= busload.LIMIT
        assert part.endswith(f"{better:.1%}")
