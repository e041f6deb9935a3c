"""A headless Chromium for tests, driven through its DevTools protocol over a websocket."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

FLAGS = ("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage",
         "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
         "--hide-scrollbars", "--remote-debugging-port=0", "--mute-audio")
KEYS = {"ArrowUp": 38, "ArrowDown": 40, "ArrowLeft": 37, "ArrowRight": 39}


class Page:
    """One tab."""

    def __init__(self, browser: Browser, address: str, target: str) -> None:
        self._browser, self._target = browser, target
        self._socket = connect(address, max_size=None, open_timeout=600)
        self._numbers = itertools.count(1)
        self.events: list[dict[str, Any]] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=600))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, script: str, seconds: float = 600.0) -> Any:
        """Wait until an expression becomes true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := self.run(script):
                return value
            time.sleep(0.05)
        shown = self.run("document.body.innerText")
        raise AssertionError(f"still not so after {seconds} s: {script}\nthe page says: {shown[:1500]}")

    def press(self, key: str) -> None:
        """One key, down and up, as a keyboard sends it."""
        code = KEYS.get(key) or ord(key.upper())
        name = key if key in KEYS else f"Digit{key}" if key.isdigit() else f"Key{key.upper()}"
        details = {"key": key, "code": name, "windowsVirtualKeyCode": code, "nativeVirtualKeyCode": code}
        text = {} if key in KEYS else {"text": key}
        self.call("Input.dispatchKeyEvent", type="keyDown", **text, **details)
        self.call("Input.dispatchKeyEvent", type="keyUp", **details)

    def click(self, text: str) -> None:
        """Click the button or tab that says so; tabs listen to the mouse only."""
        where = self.run(
            "(() => { const all = [...document.querySelectorAll('button,[role=tab]')];"
            f"const found = all.find(b => b.innerText.trim() === {json.dumps(text)}); if (!found) return null;"
            "if (found.tagName === 'BUTTON' && found.role !== 'tab') { found.click(); return [0, 0]; }"
            "found.scrollIntoView({block: 'center'}); const r = found.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        assert where, f"no button {text!r} on the page:\n{self.get_text()}"
        if where == [0, 0]:
            return
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=where[0], y=where[1], button="left", clickCount=1)

    def get_text(self) -> str:
        return self.run("document.body.innerText")

    def take_picture(self, path: str | Path | None = None) -> bytes:
        picture = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            Path(path).write_bytes(picture)
        return picture

    def close(self) -> None:
        self._socket.close()
        self._browser.fetch(f"json/close/{self._target}")


class Browser:
    """A running Chromium with a profile of its own."""

    def __init__(self, size: tuple[int, int] = (800, 500)) -> None:
        assert PROGRAM is not None
        self._folder = tempfile.mkdtemp(prefix="chromium-")
        self._process = subprocess.Popen(
            [PROGRAM, *FLAGS, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self._folder}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"DBUS_SESSION_BUS_ADDRESS": "none:"},
        )
        self._size = size
        self._port = self._wait_for_port()

    def _wait_for_port(self) -> int:
        path = Path(self._folder, "DevToolsActivePort")
        end = time.monotonic() + 600
        while time.monotonic() < end:
            if path.exists() and (lines := path.read_text().splitlines()):
                return int(lines[0])
            time.sleep(0.05)
        raise AssertionError("Chromium did not start")

    def fetch(self, path: str, method: str = "GET") -> Any:
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/{path}", method=method)
        with urllib.request.urlopen(request, timeout=600) as answer:
            text = answer.read().decode()
        return json.loads(text) if text.startswith(("{", "[")) else text

    def open(self, url: str = "about:blank") -> Page:
        target = self.fetch("json/new?about:blank", "PUT")
        page = Page(self, target["webSocketDebuggerUrl"], target["id"])
        page.call("Emulation.setDeviceMetricsOverride", width=self._size[0], height=self._size[1],
                  deviceScaleFactor=1, mobile=False)
        if url != "about:blank":
            page.open(url)
        return page

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)


@contextmanager
def open_browser() -> Iterator[Browser]:
    browser = Browser()
    try:
        yield browser
    finally:
        browser.close()
