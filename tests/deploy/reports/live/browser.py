"""A headless Chromium, driven by its own protocol (Chrome DevTools Protocol over a WebSocket)."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

from tests.waiting import HANG_S

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--no-first-run", "--remote-debugging-port=0",
    "--window-size=1400,1400", "--disable-quic", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
_MOST_BYTES = 1 << 27


class Page:
    """One tab."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self._connection = connection
        self._numbers = count(1)
        self.messages: list[str] = []  # on the console, and what its security policy stopped

    async def call(self, method: str, **parameters: Any) -> Any:
        number = next(self._numbers)
        request = {"id": number, "method": method, "params": parameters}
        await self._connection.write_message(json.dumps(request))
        while True:
            text = await self._connection.read_message()
            assert text is not None, "the browser is gone"
            message = json.loads(text)
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            if message.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                self.messages.append(json.dumps(message["params"]))

    async def value(self, expression: str) -> Any:
        """What a piece of JavaScript gives."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    async def await_true(self, expression: str) -> None:
        give_up_s = time.monotonic() + HANG_S
        while not await self.value(expression):
            assert time.monotonic() < give_up_s, f"waited in vain: {expression}; {self.messages}"
            time.sleep(0.1)

    async def screenshot(self, path: Path) -> None:
        answer = await self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(answer["data"]))


@asynccontextmanager
async def opened(url: str, profile: Path) -> AsyncIterator[Page]:
    """A page in a browser of its own, which is closed at the end."""
    assert CHROMIUM is not None
    browser = subprocess.Popen(
        [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        place = await _target(profile)
        connection = await websocket_connect(place, max_message_size=_MOST_BYTES)
        page = Page(connection)
        for domain in ("Page", "Runtime", "Log"):
            await page.call(f"{domain}.enable")
        await page.call("Page.navigate", url=url)
        yield page
        connection.close()
    finally:
        browser.terminate()
        with suppress(subprocess.TimeoutExpired):
            browser.wait(10)
        browser.kill()
        browser.wait()


async def _target(profile: Path) -> str:
    """Where the first tab listens."""
    from tornado.httpclient import AsyncHTTPClient

    give_up_s = time.monotonic() + HANG_S
    port_file = profile / "DevToolsActivePort"
    while True:
        with suppress(OSError, StopIteration, IndexError):
            port = port_file.read_text().split()[0]
            answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")
            targets = json.loads(answer.body)
            return str(
                next(each["webSocketDebuggerUrl"] for each in targets if each["type"] == "page")
            )
        assert time.monotonic() < give_up_s, "the browser does not come up"
        time.sleep(0.1)
