"""Who is let in to a page: requests that name this machine, come from the page itself and carry its token.

`http://HOST:PORT/?token=T` gives a cookie, which every later request must bring. The cookie is another secret than the
token, so that no cookie has to be guessed slowly.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
from dataclasses import dataclass
from http import HTTPStatus
from typing import cast
from urllib.parse import parse_qs

from websockets.asyncio.connection import Connection
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from pickproof.scenarios.pages.address import is_ours

HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


@dataclass(frozen=True)
class Limits:
    """What a page grants to clients that it does not know.

    Attributes:
        connections: open at one time; further ones are closed at once.
        patience: [s] for a request to arrive and its answer to be taken.
        pause: [s] after a wrong token before another token is looked at.
        waiting: requests that may wait for their token to be looked at; further ones are sent away.
    """

    connections: int = 64
    patience: float = 20.0
    pause: float = 1.0
    waiting: int = 8


class Door:
    """Decides over each request before the page sees it.

    Args:
        host: on which the page listens.
        port: on which the page listens.
        token: of the address.

    Attributes:
        cookie: name of its cookie; browsers keep cookies by host, and other pages of it listen on other ports.
    """

    def __init__(self, host: str, port: int, token: str, limits: Limits) -> None:
        self.cookie = f"pickproof-{port}"
        self._host, self._token, self._limits = host, token, limits
        self._secret = secrets.token_urlsafe(32)
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def answer(self, request: Request) -> Response | None:
        """The answer to a request that is not let in, or that asks for the cookie; None lets it in."""
        foreign = self._foreign(request.headers)
        if foreign:
            return _text(HTTPStatus.FORBIDDEN, foreign)
        if self._brings_cookie(request.headers):
            return None
        given = parse_qs(request.path.partition("?")[2]).get("token")
        if not given:
            return _text(
                HTTPStatus.FORBIDDEN, "the address lacks its token; open the one that was printed at the start"
            )
        return await self._answer_to_token(given[0])

    def _foreign(self, headers: Headers) -> str:
        """Why a request cannot come from the page of a user; empty if it can."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not is_ours(self._host, hosts[0]):
            return "the request names another host; open the address that was printed at the start"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "the request comes from another page"
        if "Upgrade" in headers and len(origins) != 1:
            return "a websocket must name the page that opens it"
        return ""

    def _brings_cookie(self, headers: Headers) -> bool:
        parts = (part.partition("=") for line in headers.get_all("Cookie") for part in line.split(";"))
        own = (value.strip() for name, _, value in parts if name.strip() == self.cookie)  # others' may be anything
        return any(_same(value, self._secret) for value in own)

    async def _answer_to_token(self, given: str) -> Response:
        """Tokens are looked at one after the other, with a pause after a wrong one: whoever guesses gets one a pause,
        however many connections he opens and however early he hangs up."""
        if self._waiting >= self._limits.waiting:
            return _text(HTTPStatus.TOO_MANY_REQUESTS, "too many wrong tokens; try again in a while")
        self._waiting += 1
        try:
            async with self._turn:
                if not _same(given, self._token):
                    await asyncio.sleep(self._limits.pause)
                    return _text(HTTPStatus.FORBIDDEN, "the token of the address is wrong")
        finally:
            self._waiting -= 1
        answer = _text(HTTPStatus.SEE_OTHER, "come in")
        answer.headers["Set-Cookie"] = f"{self.cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/"
        answer.headers["Location"] = "/"
        return answer


def limited(limits: Limits) -> type[ServerConnection]:
    """A class of connections of which a server keeps no more than the limit."""

    class Limited(ServerConnection):
        server: Server

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            if len(self.server.handlers) < limits.connections:
                super().connection_made(transport)
            else:
                Connection.connection_made(self, transport)  # without a handler
                cast(asyncio.Transport, transport).abort()

    return Limited


def _same(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), secret.encode())


def _text(status: HTTPStatus, line: str) -> Response:
    body = f"pickproof: {line}\n".encode()
    fields = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close"}
    return Response(status.value, status.phrase, Headers({**fields, "Cache-Control": "no-store", **HEADERS}), body)
