"""The page's HTTP and websocket server: static assets, a stream for each browser, and commands."""

from __future__ import annotations

import asyncio
import functools
import hashlib
import pathlib
import secrets
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from rigctl.config.built_type import built
from rigctl.page import command_bar
from rigctl.page.browser_stream import BrowserStream
from rigctl.page.guard import DOCS_HEADERS, HEADERS, Guard
from rigctl.page.history import WINDOWS_S
from rigctl.page.page_commands import Answer, PageCommands, RefusedError
from rigctl.page.picture import Picture
from rigctl.page.run_files import RunFiles, RunFilesError
from rigctl.page.sign_in import PROTOCOL, protocols_of

STATIC = pathlib.Path(__file__).parent / "static"
SITE = pathlib.Path(__file__).parent / "site"
"""The documentation, built by ``make docs``; the wheel carries it."""
DOCS = "/docs"
BODY_BYTES = 4096
_READ_ONLY = "this page is read-only: rigctl page --operator NAME is one that may command"
_NO_SESSION = "this browser has not signed in: open a link of rigctl page (rigctl page --link prints another)"
_USED_LINK = "the link was used before, is too old, or is another server's: rigctl page --link prints another"
_NO_DOCS = "the documentation is not built in this checkout: run `make docs`"
_OTHER_PAGE = "requests are taken from this server's own page alone"


@built
class _CommandBody(msgspec.Struct, forbid_unknown_fields=True):
    verb: str
    value: str | float | None = None  # text: of a field, as it was typed
    reason: str = ""


@built
class _ConfirmationBody(msgspec.Struct, forbid_unknown_fields=True):
    confirm: str


@built
class _LeaseBody(msgspec.Struct, forbid_unknown_fields=True):
    act: str
    reason: str = ""


@built
class _AlarmBody(msgspec.Struct, forbid_unknown_fields=True):
    act: str
    cause: str
    reason: str = ""
    minutes: str | float = ""


@built
class _NoteBody(msgspec.Struct, forbid_unknown_fields=True):
    text: str


@built
class _LinkBody(msgspec.Struct, forbid_unknown_fields=True):
    link: str


class SecurityHeaders:
    """Middleware: security headers on every answer; no Host or Origin but this server's, web sockets included."""

    def __init__(self, app: ASGIApp, guard: Guard) -> None:
        self._app, self._guard = app, guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request (ASGI)."""
        headers = Headers(scope=scope)
        if scope["type"] == "websocket":
            if self._guard.is_own_page(headers):
                await self._app(scope, receive, send)
            else:
                await WebSocket(scope, receive, send).close(4403)
            return
        if not self._guard.names_us(headers):
            await Response("this server does not go by that name\n", 421)(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = DOCS_HEADERS if scope["path"].startswith(f"{DOCS}/") else HEADERS
                message["headers"] += [(name.encode(), value.encode()) for name, value in headers.items()]
            await send(message)

        app = _refusal(_OTHER_PAGE, 403) if self._guard.is_foreign_page(headers) else self._app
        await app(scope, receive, with_headers)


def assets_digest() -> str:
    """Digest by which a browser sees that the page was replaced by another version."""
    digest = hashlib.sha256()
    for file in sorted(STATIC.iterdir()):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


class Page:
    """Routes of one page server."""

    def __init__(self, picture: Picture, guard: Guard, commands: PageCommands | None = None) -> None:
        """``commands``: None for a read-only page."""
        self._picture, self._guard, self._commands = picture, guard, commands
        self._run_files = RunFiles()
        self._hello = {
            "kind": "hello", "server": secrets.token_hex(8), "assets": assets_digest(), "windows_s": WINDOWS_S,
        }  # fmt: skip
        # More threads than commands in progress, so that HOLD never waits behind commands to a slow rig.
        self._threads = ThreadPoolExecutor(32, "commands")
        acts: dict[str, tuple[type[Any], Callable[[PageCommands, Any], Answer]]] = {
            "lease": (_LeaseBody, lambda commands, body: commands.lease(body.act, body.reason)),
            "alarm": (
                _AlarmBody,
                lambda commands, body: commands.alarm(body.act, body.cause, body.reason, body.minutes),
            ),
            "command": (_CommandBody, lambda commands, body: commands.propose(body.verb, body.value, body.reason)),
            "note": (_NoteBody, lambda commands, body: commands.note(body.text)),
            "confirm": (_ConfirmationBody, lambda commands, body: commands.confirm(body.confirm)),
        }
        self.app = Starlette(
            routes=[
                Route("/", self._index),
                WebSocketRoute("/stream", self._stream),
                *(Route(f"/api/{name}", self._post(*act), methods=["POST"]) for name, act in acts.items()),
                Route("/api/runs", self._runs),
                Route("/api/runs/{name}/{what}", self._made),
                Route("/api/sign-in", self._sign_in, methods=["POST"]),
                Route("/api/session", self._session, methods=["POST"]),
                Route("/api/sign-out", self._sign_out, methods=["POST"]),
                Mount("/static", StaticFiles(directory=STATIC)),
                _documentation(),
            ],
            middleware=[Middleware(SecurityHeaders, guard=guard)],
        )

    @staticmethod
    async def _index(_request: Request) -> Response:
        return HTMLResponse((STATIC / "index.html").read_text().replace(command_bar.MARK, command_bar.bar()))

    def _post(
        self, kind: type[Any], act: Callable[[PageCommands, Any], Answer]
    ) -> Callable[[Request], Awaitable[Response]]:
        """An endpoint for this server's own page with a session, and only with operator rights."""

        async def endpoint(request: Request) -> Response:
            commands = self._commands
            if commands is None:
                return _refusal(_READ_ONLY, 403)
            if not self._guard.is_own_page(request.headers):
                return _refusal(_OTHER_PAGE, 403)
            if not self._guard.may_command(request.headers):
                return _refusal(_NO_SESSION, 403)
            try:
                body = msgspec.json.decode(await _body_of(request), type=kind)
                answer = await asyncio.get_running_loop().run_in_executor(self._threads, act, commands, body)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
                return _refusal(f"not a command: {error}", 400)
            except RefusedError as error:
                return _refusal(str(error), 409)
            return _json(_without_lease(answer), 200 if answer.get("accepted") else 409)

        return endpoint

    async def _runs(self, request: Request) -> Response:
        """The recorded runs."""
        if not self._guard.may_read(request.headers):
            return _refusal(_NO_SESSION, 403)
        try:
            return _json({"accepted": True, "runs": await self._run_files.listed(self._rig)}, 200)
        except RunFilesError as error:
            return _refusal(str(error), 409)

    async def _made(self, request: Request) -> Response:
        """A report, a picture or the tables of a run."""
        if not self._guard.may_read(request.headers):
            return _refusal(_NO_SESSION, 403)
        try:
            async with self._run_files.made(self._rig, **request.path_params) as file:
                data = await asyncio.to_thread(file.read_bytes)
        except (RunFilesError, OSError) as error:
            return _refusal(str(error), 409)
        name = f"attachment; filename={request.path_params['name']}-{file.name}"
        return Response(data, media_type="application/octet-stream", headers={"content-disposition": name})

    @property
    def _rig(self) -> str:
        return str((self._picture.state or {}).get("rig") or "")

    async def _sign_in(self, request: Request) -> Response:
        """Exchange a one-time link for a session: the cookie, and the key in the answer."""
        if not self._guard.is_own_page(request.headers):
            return _refusal(_OTHER_PAGE, 403)
        try:
            session = self._guard.sessions.enter(msgspec.json.decode(await _body_of(request), type=_LinkBody).link)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, RefusedError) as error:
            return _refusal(f"not a link: {error}", 400)
        if session is None:
            return _refusal(_USED_LINK, 403)
        answer = _json({"accepted": True, "key": session.key}, 200)
        answer.headers["set-cookie"] = self._guard.sessions.set_cookie(session.cookie)
        return answer

    async def _session(self, request: Request) -> Response:
        """What this browser may do."""
        signed_in = self._guard.sessions.knows(request.headers)
        may_read = self._guard.may_read(request.headers)
        return _json(
            {
                "accepted": True,
                "signed_in": signed_in,
                "reads": may_read,
                "operator": self._guard.operator if signed_in else None,
                "text": "" if may_read and (signed_in or self._commands is None) else _NO_SESSION,
            },
            200,
        )

    async def _sign_out(self, request: Request) -> Response:
        if not self._guard.is_own_page(request.headers):
            return _refusal(_OTHER_PAGE, 403)
        self._guard.sessions.leave(request.headers)
        answer = _json({"accepted": True}, 200)
        answer.headers["set-cookie"] = self._guard.sessions.set_cookie("")
        return answer

    async def _stream(self, socket: WebSocket) -> None:
        if not self._guard.may_read(socket.headers):
            await socket.close(4401)
            return
        await socket.accept(PROTOCOL if PROTOCOL in protocols_of(socket.headers) else None)
        may_read = functools.partial(self._guard.may_read, socket.headers)
        await BrowserStream(socket, self._picture, self._hello, self._commands, may_read).run()

    def close(self) -> None:
        """End the commands' threads and client."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        if self._commands is not None:
            self._commands.close()


def _documentation() -> BaseRoute:
    """The documentation under /docs, readable by everybody."""
    if (SITE / "index.html").is_file():
        return Mount(DOCS, StaticFiles(directory=SITE, html=True))

    async def missing(_request: Request) -> Response:
        return PlainTextResponse(f"{_NO_DOCS}\n", 404)

    return Route(f"{DOCS}{{path:path}}", missing)


async def _body_of(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > BODY_BYTES:
            raise RefusedError(f"found more than {BODY_BYTES} bytes, expected a command")
    return body


def _without_lease(answer: Answer) -> Answer:
    """An answer for the browser, without the lease's id."""
    return {name: value for name, value in answer.items() if name != "lease"}


def _json(message: Any, status: int) -> Response:
    return Response(msgspec.json.encode(message), status, media_type="application/json")


def _refusal(text: str, status: int) -> Response:
    return _json({"accepted": False, "text": text}, status)
