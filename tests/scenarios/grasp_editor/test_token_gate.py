"""The door before a page: with the token one comes in, without it nobody does."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.grasp_editor.token_gate import COOKIE, TokenGate, reached_at


class Page(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"the page")

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def gate() -> Iterator[TokenGate]:
    inner = HTTPServer(("127.0.0.1", 0), Page)
    threading.Thread(target=inner.serve_forever, daemon=True).start()
    gate = TokenGate("127.0.0.1", 0, inner.server_port, "right")
    yield gate
    gate.close()
    inner.shutdown()
    inner.server_close()


def get(gate: TokenGate, path: str = "/", cookie: str | None = None) -> tuple[int, str, str | None]:
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=20)
    connection.request("GET", path, headers={} if cookie is None else {"Cookie": cookie})
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, body, answer.getheader("Set-Cookie")


def test_without_the_token_nobody_comes_in(gate: TokenGate) -> None:
    for path, cookie in (
        ("/", None),
        ("/?token=wrong", None),
        ("/?token=", None),
        ("/", f"{COOKIE}-{gate.port}=wrong"),
        ("/", "x"),
    ):
        status, body, given = get(gate, path, cookie)
        assert status == 403 and "the page" not in body and given is None


def test_with_the_token_one_comes_in_and_stays(gate: TokenGate) -> None:
    status, _, given = get(gate, "/?token=right")
    assert status == 303 and given is not None and "HttpOnly" in given and "SameSite=Strict" in given
    own = given.split(";")[0]
    assert get(gate, "/", own)[:2] == (200, "the page")
    assert get(gate, "/", f'jupyter={{"a": 1}}; x[y]=z w; {own}')[:2] == (200, "the page")


def test_two_pages_of_one_host_and_odd_tokens_do_not_meet(gate: TokenGate) -> None:
    """A browser sends a cookie to every port of its host, and the second page must not take the first one's away."""
    other = TokenGate("127.0.0.1", 0, gate._inner, 'a b;c="d')
    try:
        status, _, given = get(other, "/?token=a%20b%3Bc%3D%22d")
        mine = get(gate, "/?token=right")[2]
        assert status == 303 and given is not None and mine is not None
        both = "; ".join(cookie.split(";")[0] for cookie in (mine, given))
        assert given.split("=")[0] != mine.split("=")[0]
        assert get(gate, "/", both)[:2] == get(other, "/", both)[:2] == (200, "the page")
    finally:
        other.close()


def test_an_address_that_is_not_ours_is_one_line() -> None:
    with pytest.raises(InputError, match="--host"):
        TokenGate("192.0.2.1", 0, 1, "t")


def test_the_address_that_is_printed_is_one_that_others_can_open() -> None:
    assert reached_at("0.0.0.0") not in ("", "0.0.0.0", "127.0.0.1")
    assert reached_at("::") not in ("", "::", "[::]")
    assert reached_at("10.0.0.7") == "10.0.0.7"
    assert reached_at("fd00::2") == "[fd00::2]"
