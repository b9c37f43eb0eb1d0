"""Faults and disturbances for the rig that ``python -m hil serve`` runs: a local socket beside its bus.

A request and its answer are one packet of JSON each: ``{"fault": ID, "for_s": SECONDS or null}``; ``{"fault": null}``,
which ends the fault that stands; or ``{"fault": null, "disturb": {...}}`` with what stands below ``disturbances`` in a
scenario file. Only the user of the served rig and root may ask.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import socket
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec

from hil.faults.expected import InjectedFault
from hil.faults.judging.standing import FaultRefusedError, StandingFault, found, hindrance
from hil.faults.stand import Needs
from hil.hub import Hub
from hil.rig import SimulatedRig
from hil.scenario.errors import ScenarioError
from hil.scenario.running_disturbances import RunningDisturbances
from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings

TICK_NS = 1_000_000
"""Injectors are stepped once a tick, as in lockstep."""
ANSWER_S = 5.0
LONGEST_BYTES = 1 << 16
_CREDENTIALS = struct.Struct("3i")


@built
class FaultRequest(msgspec.Struct):
    """What is asked for. ``fault``: None ends the fault that stands, or begins disturbances."""

    fault: str | None
    for_s: float | None = None
    disturb: dict[str, Any] | None = None


@built
class FaultAnswer(msgspec.Struct):
    """Whether it was done, and one line about it."""

    done: bool
    text: str


def socket_of(settings: RigSettings) -> pathlib.Path:
    """Socket of the rig that is served by these settings."""
    if settings.can.interface == "rigsim":
        return pathlib.Path(f"{settings.can.channel}.faults")
    return pathlib.Path(tempfile.gettempdir()) / f"rigctl-{settings.rig}.faults"


def ask(settings: RigSettings, fault: str | None, for_s: float | None) -> FaultAnswer:
    """Put a fault into the served rig, or end the one that stands.

    Raises:
        ScenarioError: no rig is served, or its server does not answer.
    """
    return _answer(settings, FaultRequest(fault, for_s))


def disturb(settings: RigSettings, wanted: dict[str, Any]) -> FaultAnswer:
    """Begin disturbances of the served rig, see `hil.scenario.running_disturbances`.

    Raises:
        ScenarioError: no rig is served, or its server does not answer.
    """
    return _answer(settings, FaultRequest(None, disturb=wanted))


def _answer(settings: RigSettings, request: FaultRequest) -> FaultAnswer:
    path = socket_of(settings)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(ANSWER_S)
            connection.connect(str(path))
            connection.send(msgspec.json.encode(request))
            return msgspec.json.decode(connection.recv(1 << 16), type=FaultAnswer)
    except (OSError, msgspec.MsgspecError) as error:
        why = error.strerror or str(error) if isinstance(error, OSError) else str(error)
        raise ScenarioError(
            [f"{settings.rig}: no simulated rig answers at {path} ({why}): start it with python -m hil serve"],
            exit_code=1,
        ) from None


@dataclass
class ServedRig:
    """The served rig as a `hil.faults.stand.FaultyRig`."""

    settings: RigSettings
    rig: SimulatedRig
    hub: Hub

    def __post_init__(self) -> None:
        self._stranger = self.hub.speaker()

    def inject(self, frame: bytes) -> None:
        """Put a frame on the bus as a foreign node would."""
        self._stranger.send(frame)


def possible(settings: RigSettings, faults: Iterable[InjectedFault]) -> list[InjectedFault]:
    """Those of the faults that a served rig of these settings can have."""
    hub = Hub(lambda: 0)
    rig = ServedRig(settings, SimulatedRig(settings, 0, hub.attach(lambda _: None).send), hub)
    found = []
    for fault in faults:
        if fault.needs is Needs.OWN_WIRE and settings.can.interface != "rigsim":
            continue
        with contextlib.suppress(FaultRefusedError):
            StandingFault(rig, fault, 0).end()
            found.append(fault)
    return found


class FaultServer:
    """Takes requests between two turns of the service, and steps the fault that stands.

    Args:
        path: of the socket; a file of that name that is no socket is left alone.
        rig: the served rig; faults of the bus need a wire of the service's own.
        of_wire: whether the bus is the service's own.

    Raises:
        OSError: the socket cannot be made.
    """

    def __init__(self, path: pathlib.Path, rig: ServedRig, *, of_wire: bool) -> None:
        self._path, self._rig, self._of_wire = path, rig, of_wire
        self._standing: StandingFault | None = None
        self._disturbances = RunningDisturbances(rig.rig.plant, rig.settings)
        self._due_ns = 0
        if path.is_socket():
            path.unlink()  # of a server that was killed: the bus beside it is this process's
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(path))
        path.chmod(0o600)
        self._listener.listen(8)
        self._asking: list[socket.socket] = []

    def turn(self, now_ns: int) -> None:
        """FaultAnswer who asks, and step the fault once a tick."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + TICK_NS - now_ns % TICK_NS
        with contextlib.suppress(OSError):  # nobody asks
            connection, _ = self._listener.accept()
            connection.setblocking(False)
            self._asking.append(connection)
        self._asking = [one for one in self._asking if not self._answered(one, now_ns)]
        if self._standing is not None and not self._standing.step(now_ns):
            self._standing = None

    def close(self) -> None:
        """End the fault that stands, and remove the socket."""
        if self._standing is not None:
            self._standing.end()
        for connection in self._asking:
            connection.close()
        self._listener.close()
        self._path.unlink(missing_ok=True)

    def _answered(self, connection: socket.socket, now_ns: int) -> bool:
        """Whether the connection is done with."""
        try:
            data = connection.recv(LONGEST_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        with connection, contextlib.suppress(OSError):
            if data:
                _pid, uid, _gid = _CREDENTIALS.unpack(
                    connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
                )
                answer = FaultAnswer(False, f"found user {uid}, expected the user of the served rig")
                if uid in (os.geteuid(), 0):
                    answer = self._do(data, now_ns)
                connection.send(msgspec.json.encode(answer))
        return True

    def _do(self, data: bytes, now_ns: int) -> FaultAnswer:
        try:
            request = msgspec.json.decode(data, type=FaultRequest)
            if request.disturb is not None:
                return FaultAnswer(True, self._disturb(request))
            return FaultAnswer(True, self._end() if request.fault is None else self._begin(request, now_ns))
        except (msgspec.MsgspecError, ValueError) as error:
            return FaultAnswer(False, str(error))

    def _disturb(self, request: FaultRequest) -> str:
        assert request.disturb is not None
        if request.fault is not None or request.for_s is not None:
            raise FaultRefusedError("disturb: found it beside a fault, expected it alone")
        self._disturbances.begin(request.disturb)
        return f"begun: {', '.join(request.disturb)}"

    def _begin(self, request: FaultRequest, now_ns: int) -> str:
        assert request.fault is not None
        fault = found(request.fault)
        if request.for_s is not None and not 0.0 < request.for_s < 1e6:
            raise FaultRefusedError(f"--for: found {request.for_s:g}, expected seconds, above 0")
        if self._standing is not None:
            raise FaultRefusedError(f"{self._standing.id} is still injected: end it first (--end)")
        if why := hindrance(fault, served=True):
            raise FaultRefusedError(f"{fault.id}: {why}")
        if fault.needs is Needs.OWN_WIRE and not self._of_wire:
            raise FaultRefusedError(f"{fault.id}: the wire is not the simulator's own, expected a bus rigsim")
        self._standing = StandingFault(self._rig, fault, now_ns, request.for_s)
        length = "until --end" if request.for_s is None else f"for {request.for_s:g} s"
        return f"{fault.id}: {fault.what}, {length}"

    def _end(self) -> str:
        if self._standing is None:
            return "no fault is injected"
        self._standing.end()
        words, self._standing = f"{self._standing.id} has ended", None
        return words


class Serving(Protocol):
    """A running `hil.serve.Service`."""

    settings: RigSettings
    rig: SimulatedRig
    hub: Hub | None
    each_turn: Callable[[int], None] | None


@contextlib.contextmanager
def taking_faults(service: Serving) -> Iterator[None]:
    """Have a service take faults until the block ends."""
    rig = ServedRig(service.settings, service.rig, service.hub or Hub())
    path = socket_of(service.settings)
    try:
        server = FaultServer(path, rig, of_wire=service.hub is not None)
    except OSError as error:
        raise ScenarioError([f"{path}: {error.strerror}: no socket for python -m hil inject"], exit_code=1) from None
    service.each_turn = server.turn
    try:
        yield
    finally:
        service.each_turn = None
        server.close()
