"""Where a page listens, how its address is written, and by which names a browser may ask for it."""

from __future__ import annotations

import errno
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import quote

from pickproof.cell.errors import InputError

HOST = "127.0.0.1"
LEAST_TOKEN = 16  # characters
TRIES = 1000  # ports after the one asked for, on the loopback interface
LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "[::1]"})
EVERYWHERE = ("0.0.0.0", "::")
HOST_FIELD = re.compile(r"(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(:[0-9]{1,5})?")


@dataclass(frozen=True)
class Address:
    """What a user asks for.

    Attributes:
        host: name or address of this machine to listen on.
        port: 0 takes a free one.
        token: that the address of the page contains; None draws one at random.
    """

    host: str = HOST
    port: int = 8080
    token: str | None = None


def checked_token(token: str | None) -> str:
    """The token of a page, drawn at random (128 bit) unless one is given.

    Raises:
        InputError: it is shorter than `LEAST_TOKEN`, or cannot be written in an address.
    """
    if token is None:
        return secrets.token_urlsafe(16)
    if len(token) < LEAST_TOKEN or not token.isprintable():
        valid = f"at least {LEAST_TOKEN} printable characters; without --token one is drawn at random"
        raise InputError("command line", "--token", f"{len(token)} characters", valid)
    return token


def listen(address: Address) -> socket.socket:
    """A listening socket; on the loopback interface the next free port where the one asked for is taken.

    Raises:
        InputError: nothing can listen there.
    """
    host, port = address.host, address.port
    last = port + (TRIES if host == HOST and port else 0)
    while True:
        try:
            family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
            return socket.create_server(where[:2], family=family)
        except (OSError, OverflowError, UnicodeError) as error:
            port += 1
            if getattr(error, "errno", None) != errno.EADDRINUSE or port > min(last, 65_535):
                at = f"{host}:{address.port}"
                raise InputError("command line", "--host", at, f"an address to listen on ({error})") from None


def url_of(host: str, port: int, token: str) -> str:
    """The address that is given to the user; it contains the token."""
    return f"http://{reached_at(host)}:{port}/?token={quote(token, safe='')}"


def reached_at(host: str) -> str:
    """How an address writes the host at which others reach what listens on `host`.

    Of "all addresses" it is the one from which this machine would answer another network, or else its name.
    """
    if host in EVERYWHERE:
        family = socket.AF_INET if host == "0.0.0.0" else socket.AF_INET6
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as asking:  # asks the routing table, sends nothing
                asking.connect(("192.0.2.1" if family == socket.AF_INET else "2001:db8::1", 9))
                host = asking.getsockname()[0]
        except OSError:
            host = socket.gethostname()
    return f"[{host}]" if ":" in host else host


def is_ours(host: str, field: str) -> bool:
    """Whether the Host field of a request names this page, which listens on `host`.

    A web page of a stranger can make its own name lead to this machine (DNS rebinding); it cannot do so with another
    name or with a number. The port is free, because `ssh -L` may forward another one.
    """
    match = HOST_FIELD.fullmatch(field)
    if match is None:
        return False
    name = match[1].lower()
    if name in LOOPBACK_NAMES or name == reached_at(host).lower():
        return True
    return host in EVERYWHERE and (name == socket.gethostname().lower() or _is_number(name))


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
