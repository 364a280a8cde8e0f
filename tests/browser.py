"""A real browser for tests: Chromium, driven over WebDriver by plain HTTP."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import pytest
from tools import missing

NEEDED: Final = missing("chromium", "chromedriver")
needs_browser: Final = pytest.mark.skipif(bool(NEEDED), reason=NEEDED)

_OPTIONS: Final = (
    "--headless",
    "--window-size=1280,900",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)


class Browser:
    """One window of the browser."""

    def __init__(self, driver: str, profile: Path) -> None:
        self._driver = driver
        options = [*_OPTIONS, f"--user-data-dir={profile}"]
        wanted = {
            "browserName": "chrome",
            "goog:chromeOptions": {"binary": shutil.which("chromium"), "args": options},
            "goog:loggingPrefs": {"browser": "ALL"},
        }
        answer = self._ask("session", {"capabilities": {"alwaysMatch": wanted}})
        self._session = f"session/{answer['sessionId']}"

    def open(self, address: str) -> None:
        """Load a page."""
        self._ask(f"{self._session}/url", {"url": address})

    def run(self, script: str) -> Any:  # noqa: ANN401 - whatever the script returns
        """Run JavaScript in the page; return what it returns."""
        return self._ask(f"{self._session}/execute/sync", {"script": script, "args": []})

    def text(self, selector: str) -> str:
        """Return the text of an element, empty if there is none."""
        found = self.run(
            f"return document.querySelector({json.dumps(selector)})?.textContent ?? ''"
        )
        return str(found)

    def press(self, key: str) -> None:
        event = f"new KeyboardEvent('keydown', {{key: {json.dumps(key)}, bubbles: true}})"
        self.run(f"document.body.dispatchEvent({event})")

    def until(self, script: str, what: str, timeout_s: float = 120.0) -> Any:  # noqa: ANN401
        """Wait until a script returns something true; return it."""
        give_up_at = time.monotonic() + timeout_s
        while not (found := self.run(script)):
            assert time.monotonic() < give_up_at, f"it never came to {what}: {self.problems()}"
            time.sleep(0.1)
        return found

    def problems(self) -> list[str]:
        """What the page complained about since this was last asked."""
        entries = self._ask(f"{self._session}/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] == "SEVERE"]

    def narrow(self, width: int) -> None:
        """Show pages as in a window of this width, also below the least one of a window."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self._tell("Emulation.setDeviceMetricsOverride", size)

    def box(self, selector: str) -> list[float]:
        """Return left, top, width and height of an element in the window."""
        found = json.dumps(selector)
        box = f"const box = document.querySelector({found}).getBoundingClientRect();"
        values: list[float] = self.run(f"{box} return [box.left, box.top, box.width, box.height]")
        return values

    def move(self, x: float, y: float) -> None:
        self._mouse("mouseMoved", x, y)

    def drag(self, x: float, to_x: float, y: float) -> None:
        self._mouse("mousePressed", x, y, button="left", clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            self._mouse("mouseMoved", x + share * (to_x - x), y, button="left")
        self._mouse("mouseReleased", to_x, y, button="left", clickCount=1)

    def double_click(self, x: float, y: float) -> None:
        for count in (1, 2):
            self._mouse("mousePressed", x, y, button="left", clickCount=count)
            self._mouse("mouseReleased", x, y, button="left", clickCount=count)

    def _mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        self._tell("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **more})

    def _tell(self, command: str, values: Mapping[str, object]) -> None:
        self._ask(f"{self._session}/goog/cdp/execute", {"cmd": command, "params": values})

    def close(self) -> None:
        request = urllib.request.Request(f"{self._driver}/{self._session}", method="DELETE")
        with suppress(OSError):
            urllib.request.urlopen(request, timeout=20).close()

    def _ask(self, path: str, body: dict[str, Any]) -> Any:  # noqa: ANN401 - JSON
        request = urllib.request.Request(
            f"{self._driver}/{path}",
            json.dumps(body).encode(),
            {"Content-Type": "application/json"},
        )
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(error.read().decode()) from None


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Open a browser that keeps its things in a folder; nothing of it outlives the context."""
    driver, port = _start_driver()
    with driver:
        try:
            one = Browser(f"http://127.0.0.1:{port}", folder / "browser")
            try:
                yield one
            finally:
                one.close()
        finally:
            driver.kill()


def _start_driver() -> tuple[subprocess.Popen[str], str]:
    """Start the driver of the browser; return it with its port.

    It takes a port that is free on one address family, then ends if another program has it on the
    other one. So it is asked again.
    """
    for _ in range(10):
        driver = subprocess.Popen(
            ["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True, process_group=0
        )
        assert driver.stdout is not None
        for line in driver.stdout:
            if "started successfully on port" in line:
                return driver, line.rpartition(" ")[2].strip(" .\n")
        driver.wait()
    raise AssertionError("chromedriver did not start")
