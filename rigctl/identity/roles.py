"""Roles and names of those who hold a key of the rig."""

from __future__ import annotations

import re
from enum import Enum

GATEWAY_NAME = "gateway"
"""Name of the gateway in a key folder; no person can have it."""
_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
NAME_ALLOWED = "1 to 32 letters a-z, digits, - or _, the first a letter"


class Role(Enum):
    """What the holder of a certificate may do; each role may do what those before it may."""

    VIEWER = "viewer"  # read
    OPERATOR = "operator"  # command
    MAINTAINER = "maintainer"  # calibrate, identify, exchange gains
    GATEWAY = "gateway"  # no person: answers for its rig
    PAGE = "page"  # no person: a server of HTTPS, with no rights on the network of the rig

    def includes(self, other: Role) -> bool:
        """Whether this role may do what ``other`` may; gateway and page command nothing."""
        return self in PEOPLE and other in PEOPLE and PEOPLE.index(self) >= PEOPLE.index(other)

    @property
    def is_server(self) -> bool:
        """Whether its certificate is good for a server, at the names and addresses in it."""
        return self not in PEOPLE


PEOPLE = (Role.VIEWER, Role.OPERATOR, Role.MAINTAINER)


def is_name(text: str) -> bool:
    """Whether ``text`` can name the holder of a certificate: it is a part of a key, and of a file's name."""
    return _NAME.fullmatch(text) is not None


def common_name(name: str, serial: str) -> str:
    """The common name (CN) in a certificate.

    It is different in every certificate of a name, because Zenoh's access control knows a certificate by its common
    name alone: a revoked key must stay refused when its owner gets a new one.
    """
    return f"{name}.{serial}"
