"""A headless browser, driven through the DevTools protocol. Only Chromium and the package websockets are needed."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-background-networking",
    "--no-first-run",
    "--mute-audio",
    "--disable-features=BackForwardCache",  # a page that is left is closed
    # WebGL without a graphics card.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
)
_PATIENCE = 90.0  # seconds: how long a busy machine may take
_Found = TypeVar("_Found")


def find_browser() -> str | None:
    """The program of a browser; None where none is installed."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def wait_until(look: Callable[[], _Found], what: str) -> _Found:
    """Call ``look`` until it returns neither None nor False."""
    end = time.monotonic() + _PATIENCE
    while (found := look()) is None or found is False:
        assert time.monotonic() < end, f"waited for {what}"
        time.sleep(0.05)
    return found


class Browser:
    """A page of a headless browser."""

    def __init__(self, program: str, width: int = 900, height: int = 600) -> None:
        from websockets.sync.client import connect

        self._folder = tempfile.mkdtemp(prefix="browser-")
        folder = f"--user-data-dir={self._folder}"
        self._process = subprocess.Popen(
            [program, *_FLAGS, folder, f"--window-size={width},{height}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            port = wait_until(self._port, "the browser")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
                pages = json.load(answer)
            address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
            self._socket = connect(address, max_size=None, open_timeout=_PATIENCE, ping_interval=None)
        except BaseException:
            self._end()
            raise
        self._count = 0
        self.requests: list[str] = []
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)  # viser's page connects again only with focus

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()
        self._end()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol."""
        answer = self._call(method, **parameters)
        assert "error" not in answer, answer
        return answer["result"]

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; return the answer, which may be an error while a page changes."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=_PATIENCE))
            if message.get("method") == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(message["params"]["exceptionDetails"])[:500])
            if message.get("id") == self._count:
                return message

    def open(self, address: str) -> None:
        """Open a page."""
        self.requests.clear()
        self.call("Page.navigate", url=address)

    def evaluate(self, expression: str) -> Any:
        """Compute a value in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def text(self) -> str:
        """The text of the page."""
        return self.evaluate("document.body ? document.body.innerText : ''") or ""

    def wait_for_text(self, text: str) -> None:
        wait_until(lambda: text in self.text(), f"the text {text!r}")

    def click(self, text: str) -> None:
        """Click the button, or the box, that has this text or label."""
        find = f"""(() => {{
            const text = {json.dumps(text)};
            const button = [...document.querySelectorAll("button")].find((one) => one.innerText.trim() === text);
            const label = [...document.querySelectorAll("label")].find((one) => one.innerText.trim() === text);
            const box = label && (label.querySelector("input") || document.getElementById(label.htmlFor)
                || label.parentElement.parentElement.querySelector("input"));
            const target = button || box;
            if (!target) return false;
            target.scrollIntoView({{ block: "center" }});
            target.click();
            return true;
        }})()"""
        wait_until(lambda: self.evaluate(find), f"something to click, {text!r}")

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        """Drag the mouse with its left button."""
        common = {"button": "left", "buttons": 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], **common)
        for part in range(1, 9):
            x, y = (a + (b - a) * part / 8 for a, b in zip(start, end, strict=True))
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **common)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **common)

    def screenshot(self, path: Path | None = None) -> np.ndarray:
        """The pixels of the page, [H, W, 3] uint8."""
        options = {"format": "png", "optimizeForSpeed": True}  # of the encoder
        answer = wait_until(lambda: self._call("Page.captureScreenshot", **options).get("result"), "a screenshot")
        data = base64.b64decode(answer["data"])
        if path is not None:
            path.write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def _port(self) -> int | None:
        file = Path(self._folder) / "DevToolsActivePort"
        lines = file.read_text().splitlines() if file.is_file() else []
        return int(lines[0]) if lines else None

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)  # the browser and the processes it started
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
