"""``rigctl keys``: the rig's own authority, and the keys of its gateway and of people."""

from __future__ import annotations

import datetime
import pathlib
import sys
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.options import BAD, DONE, USAGE, Json, end, number_option, say, say_json
from rigctl.config.typed_number import TypedNumber
from rigctl.identity.credentials import CredentialsError
from rigctl.identity.key_folder import HostError, KeyFolder, KeyFolderError
from rigctl.identity.roles import GATEWAY_NAME, Role
from rigctl.ipc import wall_clock

if TYPE_CHECKING:
    from rigctl.identity.access_file import Certified
    from rigctl.identity.issuing import KeyIssuer

FOLDER = pathlib.Path("keys")
SOON = datetime.timedelta(days=30)


class KeysTask(Enum):
    """Actions on a key folder."""

    INIT = "init"
    ADD = "add"
    REVOKE = "revoke"
    LIST = "list"
    RENEW = "renew"


What = Annotated[KeysTask, typer.Argument(metavar="init|add|revoke|list|renew", help="What to do.")]
Name = Annotated[str | None, typer.Argument(metavar="NAME", help="Whose key; not with init and list.")]
ROLES = [role.value for role in Role if role is not Role.GATEWAY]
_ROLES = "|".join(ROLES)
Of = Annotated[str | None, typer.Option("--role", metavar=_ROLES, help="With add: what they may do.")]
Folder = Annotated[pathlib.Path, typer.Option("--dir", metavar="FOLDER", help="Key folder.")]
Days = Annotated[
    int | None,
    number_option(
        TypedNumber("days", 1, 3650, whole=True), "--days", metavar="DAYS",
        help="How long the key is good [365, a gateway's 825].",
    ),
]  # fmt: skip
Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", metavar="HOST", help="Name or address of gateway or page; several times."),
]
_NAMED = (KeysTask.ADD, KeysTask.REVOKE, KeysTask.RENEW)


def keys(
    task: What,
    name: Name = None,
    role: Of = None,
    folder: Folder = FOLDER,
    days: Days = None,
    host: Hosts = None,
    json: Json = False,
) -> None:
    """Make the rig's keys: who may watch, command, calibrate over the network.

    init makes the authority and the gateway's key; add gives a person a key for a role; renew gives another before the
    old one expires; revoke refuses all keys of a name from now on. A daemon that runs takes changes over within a few
    seconds. The rig file names the folder: telemetry.tls.keys. With --role page it is no person's key, but the
    certificate and key of a page's HTTPS.
    """
    if (name is not None) is not (task in _NAMED):
        end(USAGE, f"found {'a' if name is not None else 'no'} NAME, expected one with add, revoke and renew alone")
    if (role is not None) is not (task is KeysTask.ADD):
        end(USAGE, f"found {'a' if role is not None else 'no'} --role, expected one with add alone")
    if role is not None and role not in ROLES:
        end(USAGE, f"found --role {role[:40]!r}, expected {', '.join(ROLES)}")
    if host and task is not KeysTask.RENEW and task is not KeysTask.INIT and role != Role.PAGE.value:
        end(USAGE, f"found --host, expected with init, with --role {Role.PAGE.value}, or with renew of such a key")
    now = datetime.datetime.now(datetime.UTC)
    if why := wall_clock.unset(now):
        sys.stderr.write(f"WARNING: {why}: keys are valid from and until dates of this clock; set it\n")
    try:
        if task is KeysTask.LIST:
            _list(KeyFolder(folder), now, json)
        else:
            _change(task, name or "", Role(role or "viewer"), folder, now, days, host or [], json)
    except HostError as error:
        end(USAGE, str(error))
    except (KeyFolderError, CredentialsError) as error:
        end(BAD, str(error))
    end(DONE)


def _change(
    task: KeysTask,
    name: str,
    role: Role,
    folder: pathlib.Path,
    now: datetime.datetime,
    days: int | None,
    hosts: list[str],
    json: bool,
) -> None:
    from rigctl.identity.issuing import GATEWAY_DAYS, PERSON_DAYS, KeyIssuer

    issuer = KeyIssuer(folder, now)
    if task is KeysTask.REVOKE:
        count = issuer.revoke(name)
        if json:
            say_json({"name": name, "revoked": count})
        else:
            say(f"{name}: revoked; a daemon that runs refuses it within a few seconds")
        return
    acts: dict[KeysTask, Callable[[], Certified]] = {
        KeysTask.INIT: lambda: issuer.init(hosts, days or GATEWAY_DAYS),
        KeysTask.ADD: lambda: issuer.add(name, role, days or PERSON_DAYS, hosts),
        KeysTask.RENEW: lambda: issuer.renew(name, days, hosts),
    }
    made = acts[task]()
    if json:
        say_json(_row(made))
    else:
        say(_made(issuer, made))


def _made(issuer: KeyIssuer, made: Certified) -> str:
    until = f"good until {made.not_after:%Y-%m-%d}"
    if made.name == GATEWAY_NAME:
        return f"{issuer.folder.gateway}: the gateway's key, {until}"
    file = issuer.folder.issued(made.name)
    if made.role is Role.PAGE:
        return f"{file}: certificate and key of HTTPS, {until}; it is both page.tls_cert and page.tls_key"
    return f"{file}: key of {made.name}, {made.role.value}, {until}; hand it over, then delete it here"


def _list(folder: KeyFolder, now: datetime.datetime, json: bool) -> None:
    found = folder.certificates()
    if json:
        say_json([_row(one) | {"standing": one.standing(now)} for one in found])
        return
    width = max(len(one.name) for one in found)
    for one in found:
        standing = one.standing(now)
        if one.revoked is not None:
            standing += f" {one.revoked:%Y-%m-%d %H:%M}"
        elif one.is_valid(now) and one.not_after - now < SOON:
            standing += f", ends soon: rigctl keys renew {one.name}"
        say(f"{one.name:{width}}  {one.role.value:10}  {one.serial}  until {one.not_after:%Y-%m-%d}  {standing}")


def _row(one: Certified) -> dict[str, Any]:
    import msgspec

    return dict(msgspec.to_builtins(one))
