"""The door before a page, attacked over real sockets: who lacks its token, or comes from elsewhere, stays out."""

from __future__ import annotations

import contextlib
import http.client
import socket
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import pytest
import viser
from viser.infra import _infra
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from pickproof.cell.errors import InputError
from pickproof.scenarios.pages.address import LEAST_TOKEN, Address, is_ours, reached_at
from pickproof.scenarios.pages.door import Limits
from pickproof.scenarios.pages.viser_page import serve
from tests.scenarios.sockets import listening

pytestmark = pytest.mark.slow

TOKEN = "a token; of=a user\"'%"
PATIENCE = 60.0  # [s] that a busy machine may take


@dataclass
class Page:
    """A page that is served, and what a client of it says."""

    server: viser.ViserServer
    url: str
    changed: list[str] = field(default_factory=list)

    @property
    def port(self) -> int:
        return self.server.get_port()

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    def get(self, path: str = "/", cookie: str | None = None, **fields: str) -> tuple[int, str, str | None]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        sent = {"Host": self.host} | fields | ({} if cookie is None else {"Cookie": cookie})
        connection.request("GET", path, headers=sent)
        answer = connection.getresponse()
        body = answer.read().decode()
        connection.close()
        return answer.status, body, answer.getheader("Set-Cookie")

    def cookie(self) -> str:
        parts = urlsplit(self.url)
        status, _, given = self.get(f"{parts.path}?{parts.query}")
        assert status == 303 and given is not None
        assert "HttpOnly" in given and "SameSite=Strict" in given
        return given.partition(";")[0]

    def websocket(self, cookie: str | None, origin: str | None) -> ClientConnection:
        return connect(
            f"ws://{self.host}/",
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            additional_headers={} if cookie is None else {"Cookie": cookie},
            max_size=None,
            open_timeout=PATIENCE,
            proxy=None,
        )


@contextlib.contextmanager
def served(limits: Limits, token: str | None = TOKEN, host: str = "127.0.0.1") -> Iterator[Page]:
    server, url = serve("a page", Address(host, 0, token), limits)
    try:
        yield Page(server, url)
    finally:
        server.stop()


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with served(Limits(pause=0.01)) as built:
        yield built


def soon(condition: Callable[[], object]) -> None:
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < PATIENCE
        time.sleep(0.02)


def test_without_the_token_nobody_comes_in(page: Page) -> None:
    name = page.cookie().partition("=")[0]
    wrong = (("/", None), ("/?token=wrong", None), ("/?token=", None), ("/?token=%FF", None), ("/", "x"))
    for path, cookie in (*wrong, ("/", f"{name}="), ("/", f"{name}=\xff"), ("/index.html", f"{name}={TOKEN}")):
        status, body, given = page.get(path, cookie)
        assert status == 403 and "<html" not in body and given is None
    with pytest.raises(InvalidStatus, match="403"):
        page.websocket(None, f"http://{page.host}")


def test_with_the_token_page_and_websocket_work(page: Page) -> None:
    cookie = page.cookie()
    for sent in (cookie, f'jupyter={{"a": 1}}; x[y]=z w; {cookie}'):
        status, body, _ = page.get("/", sent)
        assert status == 200 and "<html" in body
    with page.websocket(cookie, f"http://{page.host}") as client:
        assert len(client.recv(timeout=PATIENCE)) > 0


def test_no_other_page_may_frame_it(page: Page) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=PATIENCE)
    for fields, status in (({}, 403), ({"Cookie": page.cookie()}, 200)):
        connection.request("GET", "/", headers=fields)
        answer = connection.getresponse()
        answer.read()
        assert answer.status == status and answer.getheader("X-Frame-Options") == "DENY"
        connection.close()


def test_another_page_of_the_same_browser_stays_out_with_its_cookie(page: Page) -> None:
    cookie = page.cookie()
    near = f"http://127.0.0.1:{page.port + 1}"  # a browser sends it the same cookies
    for origin in ("http://evil.example", near, f"https://{page.host}", f"http://localhost:{page.port}", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            page.websocket(cookie, origin)
        assert page.get("/", cookie, Origin=origin)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        page.websocket(cookie, None)


def test_a_host_name_that_leads_here_is_not_ours(page: Page) -> None:
    cookie, path = page.cookie(), "/?" + urlsplit(page.url).query
    evil = f"evil.example:{page.port}"
    for host in (evil, f"127.0.0.1.evil.example:{page.port}", "10.9.9.9", f"127.0.0.1:1@{evil}", "", "[::1"):
        assert page.get("/", cookie, Host=host)[0] == 403
        status, _, given = page.get(path, Host=host, Origin=f"http://{host}")
        assert status == 403 and given is None
    assert page.get("/", cookie, Host="localhost:9000")[0] == 200  # ssh -L may forward another port


def test_names_of_a_page_that_listens_in_the_network() -> None:
    assert is_ours("0.0.0.0", "10.0.0.7:8080") and is_ours("::", "[fd00::2]:8080")
    assert is_ours("0.0.0.0", f"{socket.gethostname()}:8080") and is_ours("Cell.lan", "cell.lan:8080")
    assert not is_ours("0.0.0.0", "evil.example:8080") and not is_ours("10.0.0.7", "10.0.0.8:8080")
    with served(Limits(), host="0.0.0.0") as page:
        assert page.get("/", page.cookie())[0] == 200
        assert page.get("/", page.cookie(), Host=f"evil.example:{page.port}")[0] == 403


def test_two_pages_of_one_host_do_not_take_each_other_s_cookie(page: Page) -> None:
    with served(Limits()) as other:
        both = f"{page.cookie()}; {other.cookie()}"
        assert page.get("/", both)[0] == other.get("/", both)[0] == 200
        assert other.get("/", page.cookie())[0] == 403


def test_wrong_tokens_wait_and_the_cookie_does_not() -> None:
    with (
        served(Limits(pause=9 * PATIENCE, patience=9 * PATIENCE, waiting=2)) as page,
        contextlib.ExitStack() as guessers,
    ):
        cookie = page.cookie()

        def guess() -> socket.socket:
            client = guessers.enter_context(socket.create_connection(("127.0.0.1", page.port)))
            client.sendall(f"GET /?token=guess HTTP/1.1\r\nHost: {page.host}\r\n\r\n".encode())
            return client

        def sent_away() -> bool:
            """Those that wait are not answered, so an answer means that the two before it wait."""
            client = guess()
            client.settimeout(0.2)
            with contextlib.suppress(TimeoutError):
                return b" 429 " in client.recv(4096)
            return False

        soon(sent_away)
        assert page.get("/", cookie)[0] == 200
        assert page.get("/?" + urlsplit(page.url).query)[0] == 429


def test_half_requests_end_and_further_connections_are_closed(capfd: pytest.CaptureFixture[str]) -> None:
    with served(Limits(connections=3, patience=1.0)) as page, contextlib.ExitStack() as clients:

        def half() -> socket.socket:
            client = clients.enter_context(socket.create_connection(("127.0.0.1", page.port), timeout=PATIENCE))
            client.sendall(b"GET / HT")
            return client

        for client in [half() for _ in range(8)]:
            with contextlib.suppress(ConnectionResetError):
                assert client.recv(4096) == b""  # closed, now or when the time is over
        for noise in (
            b"\x16\x03\x01\x00\xff\r\n\r\n",
            b"POST / HTTP/1.1\r\n\r\n",
            b"GET / HTTP/1.1\r\n" + b"x" * 90_000,
        ):
            client = clients.enter_context(socket.create_connection(("127.0.0.1", page.port), timeout=PATIENCE))
            with contextlib.suppress(OSError):
                client.sendall(noise)
                client.recv(4096)
            client.close()
        soon(lambda: _status(page) == 303)
    said = capfd.readouterr()
    assert "Traceback" not in said.out + said.err


def _status(page: Page) -> int:
    with contextlib.suppress(OSError, http.client.HTTPException):
        return page.get("/?" + urlsplit(page.url).query)[0]
    return 0


def test_no_more_connections_than_the_limit_are_open() -> None:
    with served(Limits(connections=3)) as page:
        cookie, origin = page.cookie(), f"http://{page.host}"
        opened: list[ClientConnection] = []
        with pytest.raises((OSError, EOFError, ConnectionClosed, InvalidMessage)):
            while len(opened) < 4:
                opened.append(page.websocket(cookie, origin))
        assert opened  # 2 where the request for the cookie was still being closed
        for client in opened:
            client.close()
        soon(lambda: _status(page) == 303)


def test_a_client_that_breaks_the_protocol_prints_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    with served(Limits()) as page, page.websocket(page.cookie(), f"http://{page.host}") as client:
        client.send("text, where viser expects bytes")
        with pytest.raises(ConnectionClosed):
            while True:
                client.recv(timeout=PATIENCE)
    said = capfd.readouterr()
    assert "Traceback" not in said.out + said.err


def test_no_inner_port_listens() -> None:
    before = listening()
    with served(Limits()) as page:
        assert listening() - before == {f"0100007F:{page.port:04X}"}


def test_short_tokens_are_refused_and_drawn_ones_differ() -> None:
    for token in ("", "t", "x" * (LEAST_TOKEN - 1), "x" * LEAST_TOKEN + "\udc80"):
        with pytest.raises(InputError, match=f"--token.*at least {LEAST_TOKEN} "):
            serve("a page", Address(port=0, token=token))
    with served(Limits(), None) as one, served(Limits(), None) as two:
        tokens = [urlsplit(page.url).query for page in (one, two)]
        assert tokens[0] != tokens[1] and min(map(len, tokens)) > len("token=") + LEAST_TOKEN


def test_a_taken_port_gives_the_next_one_on_this_machine_only(page: Page) -> None:
    server, url = serve("a page", Address(port=page.port))
    server.stop()
    assert urlsplit(url).port != page.port
    with pytest.raises(InputError, match="--host"):
        serve("a page", Address("192.0.2.1", 0))
    with socket.create_server(("0.0.0.0", 0)) as taken, pytest.raises(InputError, match="--host"):
        serve("a page", Address("0.0.0.0", taken.getsockname()[1]))


def test_a_viser_that_does_not_ask_the_door_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another version may listen in another way; its page must not stand open."""
    kept = types.SimpleNamespace(serve=_infra.websockets.asyncio.server.serve, ServerConnection=object)
    apart = types.SimpleNamespace(
        asyncio=types.SimpleNamespace(server=kept),
        exceptions=_infra.websockets.exceptions,
        datastructures=_infra.websockets.datastructures,
    )
    monkeypatch.setattr(_infra, "websockets", apart)
    before = listening()
    with pytest.raises(InputError, match="viser"):
        serve("a page", Address(port=0))
    soon(lambda: listening() <= before)


def test_the_address_that_is_printed_is_one_that_others_can_open() -> None:
    assert reached_at("0.0.0.0") not in ("", "0.0.0.0", "127.0.0.1")
    assert reached_at("::") not in ("", "::", "[::]")
    assert reached_at("10.0.0.7") == "10.0.0.7"
    assert reached_at("fd00::2") == "[fd00::2]"
