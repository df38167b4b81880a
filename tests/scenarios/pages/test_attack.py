"""A web page of a stranger, opened in the browser in which a page of ours is open, tries to use it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

import pytest
import viser

from pickproof.scenarios.pages.address import Address
from pickproof.scenarios.pages.viser_page import serve
from tests.scenarios.browser import CHROMIUM, Browser

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")]

EVIL = "evil.example"
NAMES = f"--host-resolver-rules=MAP {EVIL} 127.0.0.1"  # the stranger's name leads to this machine: DNS rebinding
OPENED = """new Promise(done => {{
    const socket = new WebSocket("ws://{host}/", "viser-v{version}");
    socket.onmessage = () => done("let in");
    socket.onerror = socket.onclose = () => done("kept out");
}})"""
READ = """fetch("http://{host}/", {{credentials: "include"}}).then(a => a.text()).then(
    text => text.includes("<html") ? "read" : text, () => "kept out")"""


class Strange(BaseHTTPRequestHandler):
    """A page of another server of this machine; a browser takes it for the same site, and sends it the same cookies."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>strange</title><body>a page of a stranger")

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is printed."""


@pytest.fixture(scope="module")
def strange_port() -> Iterator[int]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Strange)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_port
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("attack"), 640, 480, [NAMES]) as opened:
        yield opened


def script(text: str, host: str) -> str:
    return text.format(host=host, version=viser.__version__)


def test_the_attack_works_on_a_page_without_a_door(browser: Browser, strange_port: int) -> None:
    """Else the next test would hold for another reason."""
    bare = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        browser.open(f"http://{EVIL}:{strange_port}/")
        assert browser.run(script(OPENED, f"127.0.0.1:{bare.get_port()}")) == "let in"
        rebound = f"{EVIL}:{bare.get_port()}"
        browser.open(f"http://{rebound}/")
        assert browser.run(script(READ, rebound)) == "read"
    finally:
        bare.stop()


def test_strangers_are_kept_out_while_the_user_works(browser: Browser, strange_port: int) -> None:
    server, url = serve("a page", Address(port=0))
    try:
        number = server.gui.add_number("width", 1.0)
        host = urlsplit(url).netloc
        browser.open(url)
        browser.until("document.body.innerText.includes('width')")
        assert browser.run("location.search + document.cookie") == ""  # no script can pass the secrets on
        assert browser.run(script(OPENED, host)) == "let in"
        for name in (f"127.0.0.1:{strange_port}", f"localhost:{strange_port}", f"{EVIL}:{strange_port}"):
            browser.open(f"http://{name}/")
            browser.until("document.body.innerText.includes('a page of a stranger')")
            assert browser.run(script(OPENED, host)) == "kept out"
        rebound = f"{EVIL}:{urlsplit(url).port}"
        for path in ("/", f"/?{urlsplit(url).query}"):
            browser.open(f"http://{rebound}{path}")
            browser.until("document.body.innerText.includes('another host')")
            assert browser.run(script(OPENED, rebound)) == browser.run(script(OPENED, host)) == "kept out"
            assert "another host" in browser.run(script(READ, rebound))
        assert number.value == 1.0
        browser.open(f"http://{host}/")  # the user himself is let in with his cookie
        browser.until("document.body.innerText.includes('width')")
    finally:
        server.stop()
