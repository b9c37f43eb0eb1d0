"""A rig whose devices answer SDOs with garbage: the start-up always ends, in success or in one line."""

from __future__ import annotations

import random
import struct
from collections import Counter
from collections.abc import Callable, Iterator

from hil.hub import Port
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.devices import objects as od
from rigctl.devices.remote_node import StartupError
from tests.builders.rig_on_hub import RigOnHub
from tests.fuzz.judge import Tally

TIMEOUT_MS = 20
_ABORTS = (0x05030000, 0x05040000, 0x06010000, 0x06020000, 0x06070010, 0x06090030, 0x08000000, 0)
Answer = Callable[[bytes, random.Random], list[bytes]]


def _random(_data: bytes, chance: random.Random) -> list[bytes]:
    return [chance.randbytes(8)]


def _random_value(data: bytes, chance: random.Random) -> list[bytes]:
    return [data[:4] + chance.randbytes(4)]


def _random_header(data: bytes, chance: random.Random) -> list[bytes]:
    return [bytes([chance.randrange(256)]) + data[1:]]


def _other_size(data: bytes, chance: random.Random) -> list[bytes]:
    return [bytes([0x43 | chance.randrange(4) << 2]) + data[1:]]


def _short(data: bytes, chance: random.Random) -> list[bytes]:
    return [data[: chance.randrange(8)]]


def _abort(data: bytes, chance: random.Random) -> list[bytes]:
    return [b"\x80" + data[1:4] + struct.pack("<L", chance.choice((*_ABORTS, chance.randrange(2**32))))]


def _nothing(_data: bytes, _chance: random.Random) -> list[bytes]:
    return []


def _twice(data: bytes, _chance: random.Random) -> list[bytes]:
    return [data, data]


def _segmented(data: bytes, chance: random.Random) -> list[bytes]:
    """Announce a segmented transfer of any length; `_segment` answers the requests that follow."""
    return [b"\x41" + data[1:4] + struct.pack("<L", chance.choice((0, 1, 4, 9, 2**31, 2**32 - 1)))]


def _segment(data: bytes, chance: random.Random) -> list[bytes]:
    """One more segment, rarely the last."""
    return [bytes([chance.choice((0x00, 0x10)) | (chance.random() < 0.02)]) + data[1:]]


ANSWERS: tuple[Answer, ...] = (
    _random, _random_value, _random_header, _other_size, _short, _abort, _nothing, _twice, _segmented, _segment,
)  # fmt: skip


class Liar:
    """Replaces the devices' responses from some request on. Endless: segments without a last one."""

    def __init__(self, settings: RigSettings, honest: Port, chance: random.Random) -> None:
        self._chance, self._honest = chance, honest
        self._ids = {od.SDO_TX_BASE + node for node in settings.canopen_nodes.values()}
        self._after = chance.choice((0, 0, 1, chance.randrange(120)))
        self._share = chance.choice((1.0, 0.3, 0.05))
        self._answers = chance.sample(ANSWERS, chance.randrange(1, 4))
        self._endless = chance.random() < 0.1
        self._toggle = 0
        self.told: Counter[str] = Counter()

    def tap(self, sender: Port, frame: bytes) -> Iterator[bytes]:
        """Frames that go on the wire in place of one; see `hil.hub.Hub.tap`."""
        can_id, length, data = FRAME.unpack(frame)
        if sender is not self._honest or can_id not in self._ids:
            yield frame
            return
        self._after -= 1
        if self._after >= 0 or (not self._endless and self._chance.random() >= self._share):
            yield frame
            return
        for said in self._lie(data[:length]):
            yield FRAME.pack(can_id, len(said), said)

    def _lie(self, data: bytes) -> list[bytes]:
        if self._endless:
            self.told["endless"] += 1
            if data[0] != 0x80:  # a request the device understands; it does not know the segments requested then
                self._toggle = 0
                return _segmented(data, self._chance)
            self._toggle ^= 0x10
            return [bytes([self._toggle ^ 0x10]) + data[1:]]
        answer = self._chance.choice(self._answers)
        self.told[answer.__name__.strip("_")] += 1
        return answer(data, self._chance)


def play(settings: RigSettings, count: int, seed: int) -> Tally:
    """Bring up ``count`` rigs with such devices. ``settings``: of a rig that can be simulated."""
    chance, tally = random.Random(seed), Tally()
    quick = settings.model_copy(
        update={
            "can": settings.can.model_copy(update={"heartbeat_ms": 2, "boot_wait_s": 0.0}),
            **{
                name: getattr(settings, name).model_copy(update={"sdo_timeout_ms": TIMEOUT_MS})
                for name in settings.canopen_nodes
            },
        }
    )
    for i in range(count):
        rig = RigOnHub(quick)
        liar = Liar(quick, rig.port, chance)
        rig.hub.tap = liar.tap
        tally.attempt("start-up", str(i).encode(), rig.bring_up, (StartupError,))
        for kind in liar.told:
            tally.tried[f"answered: {kind}"] += 1
    return tally
