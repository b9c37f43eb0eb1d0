"""Commands as Zenoh queries: key and payload to the command server, its answer to a reply or an error reply."""

from __future__ import annotations

from functools import partial

import zenoh

from rigctl.config.one_line import on_one_line
from rigctl.gateway.answers import answer_command
from rigctl.gateway.command_server import CommandServer, Giver
from rigctl.wire.keys import Keys
from rigctl.wire.session import MESSAGE_BYTES


def take_queries(session: zenoh.Session, keys: Keys, server: CommandServer) -> None:
    """Take the commands of persons with certificates from ``session``."""

    def take(query: zenoh.Query) -> None:
        key, reply = str(query.key_expr), partial(answer_command, query)
        name = key.rsplit("/", 1)[-1]
        try:
            giver = Giver(keys.giver(key))
        except ValueError:
            server.refuse(name, f"found the key {on_one_line(key)}, expected one rig and one command", Giver(), reply)
            return
        payload = query.payload
        if payload is not None and len(payload) > MESSAGE_BYTES:  # not copied: it is too long to be a command
            server.refuse(name, f"found {len(payload)} bytes, expected at most {MESSAGE_BYTES}", giver, reply)
            return
        server.take(name, bytes(payload) if payload is not None else None, giver, reply)

    session.declare_queryable(keys.command("*"), take)
