"""A proxy that gives access to a local page from other machines with a token.

The page itself listens on the loopback interface. A request with `/?token=...` gets a cookie, which every later
connection must send. Each connection has one HTTP request, because the page's server closes it after the answer.
"""

from __future__ import annotations

import asyncio
import hmac
import socket
import threading
from urllib.parse import parse_qs, quote, unquote, urlsplit

from pickproof.cell.errors import InputError

COOKIE = "pickproof"
HEAD_LIMIT = 16_384  # bytes
PATIENCE = 20.0  # [s] for a request to arrive


def reached_at(host: str) -> str:
    """The host name or address under which other machines reach a server that listens on `host`.

    For "all addresses" it is the address of the default route, or else the machine's name.
    """
    if host in ("0.0.0.0", "::"):
        family = socket.AF_INET if host == "0.0.0.0" else socket.AF_INET6
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as asking:  # reads the routing table, sends nothing
                asking.connect(("192.0.2.1" if family == socket.AF_INET else "2001:db8::1", 9))
                host = asking.getsockname()[0]
        except OSError:
            host = socket.gethostname()
    return f"[{host}]" if ":" in host else host


class TokenGate:
    """Listens on `host` and forwards requests with the token to a port of 127.0.0.1; close it after use.

    Attributes:
        port: on which it listens.
        cookie: name of its cookie; browsers keep cookies by host, and other pages of it listen on other ports.

    Raises:
        InputError: it cannot listen there.
    """

    def __init__(self, host: str, port: int, inner_port: int, token: str) -> None:
        self._inner, self._token = inner_port, token
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(asyncio.start_server(self._meet, host, port, limit=HEAD_LIMIT))
        except OSError as error:
            self._loop.close()
            raise InputError("command line", "--host", f"{host}:{port}", f"an address to listen on ({error})") from None
        self.port = int(self._server.sockets[0].getsockname()[1])
        self.cookie = f"{COOKIE}-{self.port}"
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening, and close open connections."""
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result(5)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)
        self._loop.close()

    async def _stop(self) -> None:
        self._server.close()
        others = [t for t in asyncio.all_tasks() if t is not asyncio.current_task()]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
            given, by_cookie = self._given(head)
            if not given:
                await _answer(writer, "403 Forbidden", "text/plain", b"pickproof: the address lacks its token\n")
            elif not by_cookie:
                value = quote(self._token, safe="")
                cookie = f"Set-Cookie: {self.cookie}={value}; HttpOnly; SameSite=Strict; Path=/\r\nLocation: /"
                await _answer(writer, "303 See Other", "text/plain", b"", cookie)
            else:
                await self._pass_on(head, reader, writer)
        except (TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ConnectionError):
            return  # the client closed the connection or does not speak HTTP
        finally:
            writer.close()

    def _given(self, head: bytes) -> tuple[bool, bool]:
        """Whether a request has the token, and whether it has it in its cookie."""
        lines = head.decode("latin-1").split("\r\n")
        parts = (line.partition(":") for line in lines[1:])
        fields = {name.strip().lower(): value.strip() for name, _, value in parts}
        cookies = (part.partition("=") for part in fields.get("cookie", "").split(";"))  # others' may be anything
        own = [unquote(value.strip()).encode() for name, _, value in cookies if name.strip() == self.cookie]
        if any(hmac.compare_digest(value, self._token.encode()) for value in own):
            return True, True
        words = lines[0].split(" ")
        asked = parse_qs(urlsplit(words[1]).query).get("token", [""])[0] if len(words) > 1 else ""
        return hmac.compare_digest(asked.encode(), self._token.encode()), False

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner)
        inner_writer.write(head)
        try:
            ways = [_copy(reader, inner_writer), _copy(inner_reader, writer)]
            await asyncio.wait([asyncio.ensure_future(way) for way in ways], return_when=asyncio.FIRST_COMPLETED)
        finally:
            inner_writer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(65_536):
        writer.write(data)
        await writer.drain()


async def _answer(
    writer: asyncio.StreamWriter, status: str, kind: str, body: bytes, more: str = "X-Frame-Options: DENY"
) -> None:
    writer.write(
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
        f"Connection: close\r\n{more}\r\n\r\n".encode()
        + body
    )
    await writer.drain()
