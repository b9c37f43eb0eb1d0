"""``python adapter.py BUS``: a serial CAN adapter between the kernel's slcan driver and BUS, with faults on demand.

It owns the master of a pseudo-terminal whose other end has the kernel's slcan line discipline, so that its CAN
interface is a real one: bit rate, error states, a transmit queue that fills. First line out: the interface's name.
Orders, one a line on standard input:

- ``say WORD...``: send each as it is: ``sp000130`` (error-passive), ``sb000256`` (bus-off), ``e1o`` (overrun), ...
- ``off``: the controller is off the bus, both ways, until its channel is opened anew.
- ``lose N``: the next N frames from the bus are lost to an overrun.
- ``stall`` / ``resume``: what the kernel sends is not taken.
- ``babble SECONDS``: a node sends its frame of highest priority without a pause; no other gets onto the bus.
"""

from __future__ import annotations

import fcntl
import io
import os
import pty
import select
import socket
import struct
import sys
import termios
import time
import tty

N_SLCAN = 17
SIOCGIFNAME = 0x8910
FRAME = struct.Struct("=IB3x8s")
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
BABBLE = b"t0018" + b"0" * 16 + b"\r"
BABBLE_HZ = 1000


def attach(slave: int) -> str:
    """Give the terminal to the slcan driver; the name of its interface."""
    tty.setraw(slave)
    fcntl.ioctl(slave, termios.TIOCSETD, struct.pack("i", N_SLCAN))
    return fcntl.ioctl(slave, SIOCGIFNAME, bytes(16)).split(b"\0")[0].decode()


def to_serial(frame: bytes) -> bytes:
    """A raw socket's frame in the driver's letters."""
    can_id, size, data = FRAME.unpack(frame)
    kind = "r" if can_id & REMOTE else "t"
    text = f"{kind.upper()}{can_id & 0x1FFFFFFF:08X}" if can_id & EXTENDED else f"{kind}{can_id & 0x7FF:03X}"
    return f"{text}{size}{'' if can_id & REMOTE else data[:size].hex().upper()}\r".encode()


def from_serial(line: bytes) -> bytes:
    """The driver's letters (of t, T, r, R) as a raw socket's frame."""
    kind, digits = line[:1], 8 if line[:1].isupper() else 3
    can_id = int(line[1 : 1 + digits], 16) | (EXTENDED if kind.isupper() else 0) | (REMOTE if kind in b"rR" else 0)
    data = bytes.fromhex(line[2 + digits :].decode())
    return FRAME.pack(can_id, int(line[1 + digits : 2 + digits]), data)


class Adapter:
    """Both ends, and what is wrong with it now."""

    def __init__(self, bus: str) -> None:
        self.master, self._slave = pty.openpty()
        self.interface = attach(self._slave)
        os.set_blocking(self.master, False)
        self.bus = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.bus.bind((bus,))
        self.is_open = self._off = self._stalled = False
        self._lose = 0
        self._babble_until = self._babble_next = 0.0
        self._unread = b""

    @property
    def babbling(self) -> bool:
        return time.monotonic() < self._babble_until

    @property
    def reads(self) -> bool:
        """What the kernel sends is taken."""
        return not (self._stalled or self.babbling)

    def order(self, words: list[str]) -> None:
        match words:
            case ["say", *said]:
                for word in said:
                    self.tell(word.encode() + b"\r")
            case ["off"]:
                self._off = True
            case ["lose", count]:
                self._lose = int(count)
            case ["stall"]:
                self._stalled = True
            case ["resume"]:
                self._stalled = False
            case ["babble", seconds]:
                self._babble_next = time.monotonic()
                self._babble_until = self._babble_next + float(seconds)
            case _:
                raise SystemExit(f"adapter: no such order: {words}")

    def tell(self, text: bytes) -> None:
        """To the kernel; what it does not take is lost, as on a serial line without handshake."""
        try:
            os.write(self.master, text)
        except BlockingIOError:
            return

    def from_kernel(self) -> None:
        *lines, self._unread = (self._unread + os.read(self.master, 4096)).split(b"\r")
        for line in lines:
            if line[:1] in (b"O", b"C"):
                self.is_open, self._off = line[:1] == b"O", False
            elif line[:1] in (b"t", b"T", b"r", b"R") and self.is_open and not self._off:
                self.bus.send(from_serial(line))

    def from_bus(self) -> None:
        frame = self.bus.recv(FRAME.size)
        if not self.is_open or self._off or self.babbling or FRAME.unpack(frame)[0] & ERROR:
            return
        if self._lose:
            self._lose -= 1
            return
        self.tell(to_serial(frame))

    def babble(self) -> None:
        """The frames due since the last turn."""
        due = int((time.monotonic() - self._babble_next) * BABBLE_HZ)
        if due and self.is_open:
            self.tell(BABBLE * min(due, 100))
        self._babble_next += due / BABBLE_HZ

    def run(self) -> None:
        """Until standard input ends; then the line is hung up, and the interface vanishes."""
        orders = io.FileIO(sys.stdin.fileno(), closefd=False)  # unbuffered: select sees all there is
        while True:
            wanted: list[io.FileIO | socket.socket | int] = [orders, self.bus, *([self.master] if self.reads else [])]
            ready, _, _ = select.select(wanted, [], [], 0.002 if self.babbling else 0.1)
            if orders in ready:
                line = orders.readline()
                if not line:
                    return
                self.order(line.decode().split())
                sys.stdout.write("done\n")
                sys.stdout.flush()
            if self.bus in ready:
                self.from_bus()
            if self.master in ready:
                self.from_kernel()
            if self.babbling:
                self.babble()


def main() -> None:
    adapter = Adapter(sys.argv[1])
    sys.stdout.write(adapter.interface + "\n")
    sys.stdout.flush()
    adapter.run()


if __name__ == "__main__":
    main()
