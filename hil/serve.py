"""``python -m hil serve``: the simulated rig in real time, in a process of its own, on the bus the rig file names."""

from __future__ import annotations

import gc
import os
import pathlib
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from time import monotonic_ns
from typing import Protocol

import can

from hil.bus_link import BusLink
from hil.hub import Hub
from hil.hub_server import HubServer
from hil.plant.plant import compile_kernel, is_compiled
from hil.rig import SimulatedRig
from hil.truth import TruthLog
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control import realtime
from rigctl.devices import can_interface, eds_file
from rigctl.ipc import output_file
from rigctl.ipc.service_manager import Watchdog, notify
from rigctl.ipc.termination import ENDING, on_signals
from rigctl.model.quantity import count

WAIT_S = 0.001
"""Longest sleep; without traffic the rig's clocks, heartbeats and time-outs advance at this pace."""

LONGEST_SILENCE_NS = 5_000_000
"""A gap between two turns of the service's loop counts at most this much as silence of the controller."""


PRIORITY_BELOW_LOOP = 10
COMPILING = "hil: compiling the plant (once)"


class ServeError(Exception):
    """The rig cannot be served: ``str()`` is one line or one per finding, ``exit_code`` 2 (settings) or 1 (bus)."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class Line(Protocol):
    """The rig's connection to the bus: ``HubServer`` or ``BusLink``."""

    received: int
    delivered: int
    lost: int
    malformed: int

    def poll(self, timeout_s: float) -> None:
        """Wait for frames and hand over those that have come."""

    def close(self) -> None:
        """Leave the bus."""


class Service:
    """A simulated rig and its line to the bus.

    Args:
        settings: a rig file with a ``simulation`` section.
        truth: file for the truth log, or None.

    Raises:
        ServeError: bad settings (2), or the bus is absent or in use (1).
    """

    def __init__(self, settings: RigSettings, truth: pathlib.Path | None = None) -> None:
        self.settings = settings
        self._stopping = False
        self.each_turn: Callable[[int], None] | None = None
        """Called with the time after every turn; see `hil.faults.served`."""
        self.hub: Hub | None = None
        """The wire, where it is this process's."""
        self._truth_log: TruthLog | None = None
        compile_kernel()  # before the bus can be joined: a daemon waits no longer for devices than its rig file says
        self.line, send = self._join()
        try:
            self._truth_log = _truth_log(truth) if truth else None
            self.rig = SimulatedRig(
                settings,
                monotonic_ns(),
                send,
                longest_silence_ns=LONGEST_SILENCE_NS,
                truth_log=self._truth_log,
            )
        except ServeError:
            self.close()
            raise
        except (OSError, ValueError) as error:
            self.close()
            raise ServeError(str(error), 2) from None

    @property
    def ready(self) -> str:
        """One line for the operator, once the rig answers frames."""
        s = self.settings
        places = {name: str(node) for name, node in s.canopen_nodes.items()}
        places |= {name: f"0x{message.can_id:03X}" for name, message in s.plain_messages.items()}
        names = {"tension_cell": "tension cell", "inclinometer": "inclinometer", "cylinder": "cylinder"}
        names |= {"rail_encoder": "rail encoder", "io": "I/O node", "second_force": "second force path"}
        devices = ", ".join(f"{name} {places[key]}" for key, name in names.items() if key in places)
        return f"serving {s.rig} on {s.can.interface}:{s.can.channel}: {devices}"

    @property
    def summary(self) -> str:
        """One line for the operator, at the end."""
        line = self.line
        taken = f"served: {count(line.received, 'frame')} in, {line.delivered} out"
        text = f"{taken}, {line.lost} lost, {line.malformed} malformed"
        if isinstance(line, HubServer):
            return f"{text}, {count(line.clients_seen, 'client')}"
        return f"{text}, {count(line.errors, 'bus error')}" if isinstance(line, BusLink) else text

    def stop(self) -> None:
        """End ``run`` at its next turn; safe in a signal handler."""
        self._stopping = True

    def run(self) -> None:
        """Serve until ``stop``. Each frame acts on the plant at its own time of arrival."""
        line, rig, watchdog = self.line, self.rig, Watchdog()
        while not self._stopping:
            line.poll(WAIT_S)
            watchdog.feed()
            now_ns = monotonic_ns()
            rig.advance(now_ns)
            rig.supervise(now_ns)
            if self.each_turn is not None:
                self.each_turn(now_ns)

    def close(self) -> None:
        """Leave the bus and close the truth log."""
        self.line.close()
        if self._truth_log is not None:
            self._truth_log.close()

    def _join(self) -> tuple[Line, Callable[[bytes], None]]:
        bus = self.settings.can
        try:
            if bus.interface == "rigsim":
                hub = self.hub = Hub()
                return HubServer(bus.channel, hub), hub.attach(self._on_frame).send
            link = BusLink(bus, self._on_frame)
            return link, link.send
        except can_interface.OpenError as error:
            raise ServeError(f"{bus.interface}:{bus.channel}: {error}", 1) from None
        except (can.CanError, OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            where = "" if str(bus.channel) in reason else f"{bus.interface}:{bus.channel}: "
            raise ServeError(f"{where}{reason}", 1) from None

    def _on_frame(self, frame: bytes) -> None:
        self.rig.advance(monotonic_ns())
        self.rig.receive(frame)


def serve(
    file: pathlib.Path,
    truth: pathlib.Path | None,
    announce: Callable[[str], None],
    beside: Callable[[Service], AbstractContextManager[None]] | None = None,
    compiling: Callable[[str], AbstractContextManager[object]] = nullcontext,
) -> None:
    """Serve the rig of ``file`` until SIGTERM, SIGINT or SIGHUP.

    ``beside``: entered around the serving; ``compiling``: with its title, around a compilation of half a minute.

    Raises:
        ServeError: with the message for the operator and the exit code.
    """
    try:
        settings = config.load(file)
    except config.ConfigError as error:
        raise ServeError(str(error), 2) from None
    if settings.simulation is None:
        raise ServeError(f"{file}: simulation: found nothing, expected a section (it says what rig to simulate)", 2)
    try:
        eds_file.check(settings)
    except eds_file.EdsError as error:
        raise ServeError(str(error), 2) from None
    compiled = is_compiled()
    if not compiled:
        sys.stderr.write(f"{COMPILING}\n")
    with nullcontext() if compiled else compiling(COMPILING):
        service = Service(settings, truth)
    on_signals(lambda *_: service.stop(), *ENDING)
    try:
        _prepare_process(settings)
        with beside(service) if beside is not None else nullcontext():
            announce(service.ready)
            notify("READY=1")
            service.run()
    finally:
        service.close()
    announce(service.summary)


def _truth_log(file: pathlib.Path) -> TruthLog:
    try:
        return TruthLog(file)
    except OSError as error:
        raise ServeError(str(output_file.OutputError(file, error, "--truth")), 2) from None


def _prepare_process(settings: RigSettings) -> None:
    """Real-time settings as the loop's, one priority lower and on the other processors; refused settings are skipped.

    A real rig never waits for the PC's scheduler; a simulated rig that waits looks like a broken bus.
    """
    others = os.sched_getaffinity(0) - {settings.loop.cpu}
    if others:
        os.sched_setaffinity(0, others)
    priority = max(0, settings.loop.priority - PRIORITY_BELOW_LOOP)
    realtime.apply(settings.loop.model_copy(update={"cpu": None, "priority": priority}))
    gc.collect()
    gc.freeze()
