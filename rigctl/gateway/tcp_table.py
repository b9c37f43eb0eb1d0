"""The kernel's table of TCP sockets of this network namespace: whose a connection is; proc(5)."""

from __future__ import annotations

import contextlib
import ipaddress
import pathlib
import sys

End = tuple[str, int]
"""Address and port of one end of a connection."""
_TABLES = ((pathlib.Path("/proc/self/net/tcp"), 4), (pathlib.Path("/proc/self/net/tcp6"), 16))  # bytes of an address


def end(address: str, port: int) -> End:
    """An end in one form for Zenoh, Python and the kernel: without a zone, and IPv4 as such on a socket of IPv6.

    Raises:
        ValueError: no address.
    """
    found = ipaddress.ip_address(address.strip("[]").partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address) and found.ipv4_mapped is not None:
        found = found.ipv4_mapped
    return str(found), port


def owners(ports: set[int]) -> dict[tuple[End, End], int]:
    """The user of each socket that is connected to one of ``ports``, by its own end and the other.

    A socket that its process has closed belongs to no one: the kernel shows inode 0 and user 0, which is not root's.
    """
    found, wanted = {}, {f"{port:04X}" for port in ports}
    for table, size in _TABLES:
        with contextlib.suppress(OSError):
            for line in table.read_text().splitlines()[1:]:  # tens of thousands, perhaps
                _, own, other, _, _, _, _, uid, _, inode = line.split(maxsplit=10)[:10]
                if other.rpartition(":")[2] in wanted and inode != "0":
                    found[_end(own, size), _end(other, size)] = int(uid)
    return found


def _end(text: str, size: int) -> End:
    """An end as the table has it: words of 32 bits in the computer's own byte order; ``size``: bytes."""
    raw, _, port = text.partition(":")
    words = bytes.fromhex(raw)
    step = -1 if sys.byteorder == "little" else 1
    native = b"".join(words[i : i + 4][::step] for i in range(0, size, 4))
    return end(str(ipaddress.ip_address(native)), int(port, 16))
