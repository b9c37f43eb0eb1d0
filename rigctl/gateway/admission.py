"""Whom the gateway's router lets in: its access list, and with certificates those of the rig's key folder.

Zenoh takes an access list only when a session is opened. The gateway therefore ends when the list has changed, and the
supervisor starts it anew, as after any end of it.
"""

from __future__ import annotations

import datetime
import secrets
from collections.abc import Mapping
from typing import Any

import zenoh

from rigctl.config.settings import RigSettings
from rigctl.gateway.kept_places import KeptPlaces, local_users
from rigctl.gateway.places import Rules
from rigctl.identity.credentials import Credentials
from rigctl.identity.key_folder import KeyFolder
from rigctl.identity.roles import PEOPLE, Role
from rigctl.ipc import wall_clock
from rigctl.ipc.folder_places import PUBLIC
from rigctl.ipc.runtime_folder import Runtime, daemon_pid
from rigctl.ipc.trusted_folders import entered_folders
from rigctl.ipc.writers import OPERATORS, VIEWERS
from rigctl.wire.access_control import access_control
from rigctl.wire.keys import Keys
from rigctl.wire.session import EndpointTakenError, SessionError, open_router

ANY_PERSON = "*"


class Admission:
    """Certificates and access list of one rig's router."""

    def __init__(self, settings: RigSettings) -> None:
        self._settings = settings
        self._folder = KeyFolder(settings.key_folder) if settings.key_folder is not None else None
        self._rules = Rules(local_users(OPERATORS))
        self.own_zid = f"1{secrets.token_hex(15)}"
        """Zenoh's id of the gateway's own session for commands; Zenoh takes no leading 0."""
        self._edition = self._folder.edition() if self._folder is not None else None
        self._clock_unset = False
        self.keys = Keys(settings.rig, ANY_PERSON if self._folder is not None else "")
        """The rig's keys; with certificates those of the commands over TLS carry the person's name."""
        self.is_taken = False
        """Whether another program had the endpoint of the network when the router was opened."""
        self.dates: dict[str, datetime.datetime] = {}
        """When the newest certificate in force began, by what it is of; TLS refuses it before, without a word."""

    def open_router(self, socket: str, *, again: bool) -> zenoh.Session:
        """Open the router; ``socket``: its second endpoint, for the gateway's own session and for this computer.

        ``again``: a gateway of this run has listened at the first one before. Another program that has taken it must
        not keep this computer's users from the rig, so it is tried until it is free.

        Raises:
            SessionError: an endpoint cannot be opened, or another daemon that this user believes has the first one.
            KeyFolderError: the key folder cannot be used, or the gateway's certificate has expired.
        """
        telemetry = self._settings.telemetry
        rig, join = self._settings.rig, telemetry.join
        if self._folder is None:
            access = access_control(rig, self.own_zid, joins=bool(join))
            return self._opened(socket, None, access, again=again)
        now = datetime.datetime.now(datetime.UTC)
        self._folder.check_gateway(now)
        certificates, self._clock_unset = self._folder.certificates(), bool(wall_clock.unset(now))
        newest = max((one for one in certificates if one.is_valid(now)), key=lambda one: one.not_before, default=None)
        self.dates = {f"the certificate of {newest.name}": newest.not_before} if newest is not None else {}
        valid = [one for one in certificates if one.is_valid(now) and one.role in PEOPLE]
        commanding = [one.common_name for one in valid if one.role.includes(Role.OPERATOR)]
        known = local_users(OPERATORS, VIEWERS).union(one.common_name for one in valid)
        self._rules = Rules(local_users(OPERATORS).union(commanding), known)
        access = access_control(rig, self.own_zid, certificates, now)
        return self._opened(socket, self._folder.gateway_credentials(), access, again=again)

    def _opened(
        self, socket: str, owned: Credentials | None, access: Mapping[str, Any], *, again: bool
    ) -> zenoh.Session:
        telemetry = self._settings.telemetry
        listen = [telemetry.listen, socket]
        try:
            return open_router(listen, telemetry.join, owned, access, patient=again)
        except EndpointTakenError as error:
            if rig := _daemon_at(telemetry.listen, self._settings.rig):
                raise SessionError(f"{error}: the daemon of {rig} has it; give one of them another port") from None
            self.is_taken = True
            return open_router(listen, telemetry.join, owned, access, patient=True)

    def places(self, session: zenoh.Session, socket: str) -> KeptPlaces:
        """The places of the router that was opened."""
        return KeptPlaces(session, [self._settings.telemetry.listen, socket], self._rules)

    def has_changed(self) -> bool:
        """Whether the access list is another than when the router was opened, or a clock that it was made by is set."""
        if self._folder is None:
            return False
        is_set = self._clock_unset and not wall_clock.unset(datetime.datetime.now(datetime.UTC))
        return is_set or self._folder.edition() != self._edition


def _daemon_at(listen: str, rig: str) -> str:
    """Another rig whose daemon, which this user believes, has the port of an endpoint; "" without one."""
    for folder, _ in entered_folders():
        if daemon_pid(folder):
            public = Runtime(folder).known(PUBLIC)
            if public.get("rig") != rig and str(public.get("listen")).rpartition(":")[2] == listen.rpartition(":")[2]:
                return str(public.get("rig"))
    return ""
