"""The studio's server: at 127.0.0.1 alone, at a free port, for who has its address, until Ctrl-C.

The address holds a secret, since every user of the computer reaches the port, and what the studio saves is its owner's.
The first page exchanges it for a cookie, which every later request must have.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import secrets
import socket
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from flexhinf.designs.request import DesignRequest
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.studio.folder import WorkingFolder
from flexhinf.validation import extra_package

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from flexhinf.studio.worker import Worker

#: The only address.
HOST = "127.0.0.1"

#: The name of the secret in the address.
SECRET = "token"

#: Names by which a browser may ask for it; another name is that of a foreign page (DNS rebinding).
NAMES = (HOST, "localhost")

#: Longest message of a browser, bytes: a text of a control is at most a few thousand.
LONGEST_MESSAGE = 100_000


def listening(port: int) -> socket.socket:
    """A socket at this port, or at a free one for 0. Raises InvalidInput: the port is taken, or not allowed."""
    refuse_if(
        not 0 <= port < 65536,
        "This is no port.",
        f"expected 0 to 65535, got {port}",
        "--port 8080, or no --port",
    )
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        taken = error.errno == errno.EADDRINUSE
        raise InvalidInput(
            f"The port {port} is {'taken' if taken else 'not to be had'}.",
            f"expected a free port at {HOST}, got: {error.strerror or error}",
            "another --port, or none",
        ) from error
    return listener


def serve(
    request: DesignRequest,
    folder: str | os.PathLike[str] = ".",
    port: int = 0,
    browser: bool = True,
    say: Callable[[str], None] = print,
) -> None:
    """Serve the studio of a robot and a design until Ctrl-C.

    Every tab begins with `request`. `say` is called with the address. Raises InvalidInput: the port cannot be had, or
    nicegui is missing.
    """
    extra_package("nicegui", "studio", "The studio is not installed.")
    import uvicorn

    from flexhinf.studio.worker import Worker

    listener = listening(port)
    port, secret = listener.getsockname()[1], secrets.token_urlsafe(24)
    address = f"http://{HOST}:{port}/?{SECRET}={secret}"
    workers = Worker(), Worker()
    try:
        app = application(request, WorkingFolder(Path(folder).absolute()), *workers, secret)
        config = uvicorn.Config(
            app, log_level="error", lifespan="on", ws_max_size=LONGEST_MESSAGE, timeout_graceful_shutdown=2
        )
        say(f"studio: {address}  (Ctrl-C ends it)")
        if browser:
            with suppress(webbrowser.Error, OSError):
                webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listener])
    finally:
        listener.close()
        for worker in workers:
            worker.stop()


def application(
    request: DesignRequest, folder: WorkingFolder, previews: Worker, files: Worker, secret: str
) -> ASGIApp:
    """The ASGI application, for one server in one process; `secret` opens it."""
    os.environ.setdefault("NICEGUI_STORAGE_PATH", os.devnull)  # nothing is stored
    from fastapi import FastAPI
    from nicegui import ui

    from flexhinf.studio.page import StudioPage
    from flexhinf.studio.session import Session

    logging.getLogger("nicegui").setLevel(logging.ERROR)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    style = (Path(__file__).parent / "studio.css").read_text(encoding="utf-8")

    def root() -> None:
        ui.add_css(style)
        StudioPage(Session(folder, request), previews, files)

    ui.run_with(  # pyright: ignore[reportUnknownMemberType]  # NiceGUI leaves its root open
        app, root=root, title="flexhinf studio", dark=None, language="en-GB", show_welcome_message=False
    )
    return OwnPages(app, secret)


class OwnPages:
    """Answers who has the secret, and refuses what another site's page has asked for: by another host name, or from
    another origin."""

    def __init__(self, app: ASGIApp, secret: str) -> None:
        self.app, self.secret = app, secret

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        own = self._is_own(headers)
        if own and self._has_cookie(headers):
            await self._answer(scope, receive, send)
        elif own and scope["type"] == "http" and self._is_secret(_query(scope)):
            cookie = f"{_cookie_name(headers)}={self.secret}; Path=/; HttpOnly; SameSite=Strict"
            await _reply(send, 303, b"", [(b"location", b"/"), (b"set-cookie", cookie.encode())])
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await _reply(
                send, 403, b"The studio answers the address that its terminal shows, and its own pages."
            )

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request; frames of a socket that are no messages end it, and nothing else."""

        async def received() -> Message:
            """The next frame; one that no page of ours sends ends the socket, before other tasks stumble over it."""
            message = await receive()
            foreign = message["type"] == "websocket.receive" and not _is_frame(message.get("text"))
            return {"type": "websocket.disconnect", "code": 1003} if foreign else message

        try:
            await self.app(scope, received if scope["type"] == "websocket" else receive, send)
        except Exception:
            if scope["type"] != "websocket":
                raise
            with suppress(Exception):  # it may be closed already
                await send({"type": "websocket.close", "code": 1003})

    def _has_cookie(self, headers: dict[bytes, bytes]) -> bool:
        cookies = SimpleCookie()
        with suppress(CookieError):
            cookies.load(headers.get(b"cookie", b"").decode("latin-1"))
        morsel = cookies.get(_cookie_name(headers))
        return morsel is not None and self._is_secret(morsel.value)

    def _is_secret(self, text: str) -> bool:
        return secrets.compare_digest(text.encode(), self.secret.encode())

    @staticmethod
    def _is_own(headers: dict[bytes, bytes]) -> bool:
        host = headers.get(b"host", b"").decode("latin-1")
        origin = headers.get(b"origin", b"").decode("latin-1")
        return host.rpartition(":")[0] in NAMES and origin in ("", f"http://{host}")


#: Frames of Engine.IO that are no message, and of Socket.IO to connect and to end; then an event with its number.
_PLAIN, _EVENT = re.compile(r"[12356](probe)?|40(\{[^{}]*\})?|41"), re.compile(r"42(\d*)(\[.*\])", re.DOTALL)


def _is_frame(text: str | None) -> bool:
    """Whether a page of the studio may have sent it: an event is a name with one mapping."""
    if text is None:
        return False
    event = _EVENT.fullmatch(text)
    if event is None:
        return _PLAIN.fullmatch(text) is not None
    try:
        parts = json.loads(event[2])
    except ValueError:
        return False
    return len(parts) == 2 and isinstance(parts[0], str) and isinstance(parts[1], dict)


def _query(scope: Scope) -> str:
    """The secret that a request states in its address; empty if none."""
    return parse_qs(scope["query_string"].decode("latin-1")).get(SECRET, [""])[0]


def _cookie_name(headers: dict[bytes, bytes]) -> str:
    """Of each port another one: cookies are shared between ports."""
    return f"flexhinf-studio-{headers.get(b'host', b'').decode('latin-1').rpartition(':')[2]}"


async def _reply(send: Send, status: int, body: bytes, headers: Sequence[tuple[bytes, bytes]] = ()) -> None:
    """A short text as the whole answer."""
    start = {"type": "http.response.start", "status": status}
    await send({**start, "headers": [(b"content-type", b"text/plain"), *headers]})
    await send({"type": "http.response.body", "body": body})
