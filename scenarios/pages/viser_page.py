"""A page of viser behind its door.

viser listens with `websockets`, and cannot be told who may come in, nor on which socket to listen. The door is therefore
built on the same library: it is asked by viser's own server before the page, and there is no second, inner port that
another user of this machine could use. A reverse proxy (aiohttp, starlette) would need one, would need the same
intervention to close it, and would copy every picture twice.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import logging
import socket
import threading
from collections.abc import Iterator
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from pickproof.cell.errors import InputError
from pickproof.scenarios.pages.address import Address, checked_token, listen, url_of
from pickproof.scenarios.pages.door import HEADERS, Door, Limits, limited

SILENT = logging.Logger("pickproof.pages")  # clients that speak no HTTP would fill the terminal with tracebacks
SILENT.addHandler(logging.NullHandler())
_starting = threading.Lock()


def serve(label: str, address: Address, limits: Limits | None = None) -> tuple[viser.ViserServer, str]:
    """A page, its panel at the right, and the address with its token at which a browser finds it.

    Raises:
        InputError: the token is too short, or nothing can listen there.
    """
    limits = limits or Limits()
    token = checked_token(address.token)
    listening = listen(address)
    port = int(listening.getsockname()[1])
    with _behind(Door(address.host, port, token, limits), listening, limits) as asked:
        server = viser.ViserServer(host=address.host, port=port, label=label, verbose=False)
    if not asked.is_set():  # it listens in another way; nothing was shown yet
        server.stop()
        listening.close()
        raise InputError("installed packages", "viser", viser.__version__, "a version that listens with websockets")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+z")
    server.scene.configure_environment_map("warehouse", environment_intensity=0.25)
    server.scene.configure_default_lights(cast_shadow=False)
    server.initial_camera.up = (0.0, 0.0, 1.0)
    return server, url_of(address.host, port, token)


@contextlib.contextmanager
def _behind(door: Door, listening: socket.socket, limits: Limits) -> Iterator[threading.Event]:
    """The server that viser starts meanwhile takes this socket and asks the door before it answers; it is set then."""
    library, asked = websockets.asyncio.server, threading.Event()
    original = library.serve

    def guarded(handler: Any, _host: str, _port: int, **options: Any) -> websockets.asyncio.server.serve:
        page = options.pop("process_request")

        async def answer(connection: ServerConnection, request: Request) -> Response | None:
            refusal = await door.answer(request)
            if refusal is not None:
                return refusal
            answered = page(connection, request)
            response: Response | None = await answered if inspect.isawaitable(answered) else answered
            if response is not None:
                response.headers.update(HEADERS)
            return response

        options |= {"open_timeout": limits.patience, "close_timeout": limits.patience, "logger": SILENT}
        options |= {"create_connection": limited(limits), "server_header": None}
        asked.set()
        return original(handler, sock=listening, process_request=answer, **options)

    with _starting, contextlib.redirect_stdout(io.StringIO()):  # viser prints an address without the token
        library.serve = guarded  # type: ignore[assignment,misc]
        try:
            yield asked
        finally:
            library.serve = original  # type: ignore[misc]
