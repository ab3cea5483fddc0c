"""The studio's server: at 127.0.0.1 alone, at a free port, until Ctrl-C."""

from __future__ import annotations

import errno
import logging
import os
import socket
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from flexhinf.design.design_file import DesignRequest
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.studio.folder import WorkingFolder
from flexhinf.validation import extra_package

#: The only address.
HOST = "127.0.0.1"

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
            f"expected a free port at {HOST}, got: {error.strerror or error}", "another --port, or none",
        ) from error  # fmt: skip
    return listener


def serve(
    request: DesignRequest, folder: str | os.PathLike[str] = ".", port: int = 0, browser: bool = True,
    say: Callable[[str], None] = print,
) -> None:  # fmt: skip
    """Serve the studio of a robot and a design until Ctrl-C.

    Every tab begins with `request`. `say` is called with the address. Raises InvalidInput: the port cannot be had, or
    nicegui is missing.
    """
    extra_package("nicegui", "studio", "The studio is not installed.")
    import uvicorn

    from flexhinf.studio.worker import Worker

    listener = listening(port)
    address = f"http://{HOST}:{listener.getsockname()[1]}/"
    workers = Worker(), Worker()
    try:
        app = application(request, WorkingFolder(Path(folder).absolute()), *workers)
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


def application(request: DesignRequest, folder: WorkingFolder, previews: Any, files: Any) -> Any:
    """The ASGI application, for one server in one process."""
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

    ui.run_with(
        app, root=root, title="flexhinf studio", dark=None, language="en-GB", show_welcome_message=False
    )
    return OwnPages(app)


class OwnPages:
    """Refuses requests that another site's page has made: by another host name, or from another origin."""

    def __init__(self, app: Any) -> None:
        self.app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer one request."""
        if scope["type"] not in ("http", "websocket") or self._is_own(dict(scope["headers"])):
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await send(
                {"type": "http.response.start", "status": 403, "headers": [(b"content-type", b"text/plain")]}
            )
            await send({"type": "http.response.body", "body": b"The studio answers its own pages alone."})

    @staticmethod
    def _is_own(headers: dict[bytes, bytes]) -> bool:
        host = headers.get(b"host", b"").decode("latin-1")
        origin = headers.get(b"origin", b"").decode("latin-1")
        return host.rpartition(":")[0] in NAMES and origin in ("", f"http://{host}")
