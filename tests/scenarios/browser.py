"""Headless chromium over its DevTools protocol: opens a page, runs script in it, notes errors and requests."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.request import urlopen

from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--no-first-run",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-sync",
    "--metrics-recording-only",
]
START = 120.0  # [s] that a busy machine may take to start it


class Browser:
    """One page of one chromium; use it as a context manager.

    Attributes:
        errors: what the console said at level error, and uncaught exceptions.
        requests: addresses asked for.
    """

    def __init__(self, folder: Path, width: int = 1280, height: int = 900) -> None:
        assert CHROMIUM is not None
        self.errors: list[str] = []
        self.requests: list[str] = []
        size = f"--window-size={width},{height}"
        words = [CHROMIUM, *FLAGS, size, f"--user-data-dir={folder / 'chromium'}", "about:blank"]
        self._process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port_file = folder / "chromium" / "DevToolsActivePort"
        begun = time.monotonic()
        while not (port_file.is_file() and port_file.read_text().strip()):
            assert self._process.poll() is None, "chromium ended at once"
            assert time.monotonic() - begun < START, "chromium did not start"
            time.sleep(0.05)
        port = port_file.read_text().split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            target = next(t for t in json.load(answer) if t["type"] == "page")
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None, open_timeout=START)
        self._id = 0
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(30)

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """Answer to a command of the protocol; events that come before it are noted."""
        self._id += 1
        self._socket.send(json.dumps({"id": self._id, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=START))
            self._note(message)
            if message.get("id") == self._id:
                assert "error" not in message, message
                return message["result"]

    def open(self, url: str) -> float:
        """Go to a page; returns the [s] until it was loaded."""
        begun = time.monotonic()
        self.send("Page.navigate", url=url)
        self.until("document.readyState === 'complete' && location.href !== 'about:blank'")
        return time.monotonic() - begun

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        answer = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, condition: str, seconds: float = START) -> None:
        """Wait until an expression in the page is true."""
        begun = time.monotonic()
        while not self.run(f"Boolean({condition})"):
            assert time.monotonic() - begun < seconds, f"never true: {condition}; {self.errors}"
            time.sleep(0.05)

    def click(self, x: float, y: float) -> None:
        """A click of the left button at a point of the page in pixels."""
        self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def picture(self, path: Path) -> Path:
        """The page as it is now, as PNG."""
        data = self.send("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))
        return path

    def heap(self) -> float:
        """Memory of scripts in [byte]."""
        return float(self.send("Runtime.getHeapUsage")["usedSize"])

    def memory(self) -> int:
        """Resident memory of the browser with all its processes in [byte]."""
        total, page = 0, 4096
        for process in [self._process.pid, *_children(self._process.pid)]:
            statm = Path(f"/proc/{process}/statm")
            if statm.exists():
                fields = statm.read_text().split()
                total += page * (int(fields[1]) - int(fields[2]))  # what is shared is left out
        return total

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"])[:500])
        if message.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.errors.append(json.dumps(params["args"])[:500])
        if message.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")


def _children(pid: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            found += [int(child), *_children(int(child))]
    return found
