"""A headless Chromium without any network, driven over a pair of pipes by the DevTools protocol.

Run as a program it saves what reports look like: python tests/headless.py FOLDER REPORT.html ...
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    # A proxy that nobody runs, also for this machine itself: there is no network.
    "--proxy-server=http://127.0.0.1:1",
    "--proxy-bypass-list=<-loopback>",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
]
DESKTOP, PHONE = 1400, 390  # px

# Advice on speed, given when a browser draws without a graphics card; that is not the page's matter.
ADVICE = ("WebGL", "GL Driver", "willReadFrequently")
LOCAL = ("file:", "data:", "blob:", "about:")
PATIENCE = 30.0  # seconds for an answer on a machine that has other things to do
KEYS = {
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Home": 36,
    "End": 35,
    "Enter": 13,
    "Tab": 9,
}


class Browser:
    """One page of a Chromium; `troubles` and `requests` hold what it complained of and asked for."""

    def __init__(self, profile: Path) -> None:
        names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
        program = next(filter(None, map(shutil.which, names)), None)
        assert program is not None, "no Chromium on the PATH; install the package chromium"
        read, self._write = os.pipe()
        self._read, write = os.pipe()
        # The browser reads its descriptor 3 and writes its descriptor 4.
        command = f'exec "$0" "$@" 3<&{read} 4>&{write}'
        self._process = subprocess.Popen(
            ["bash", "-c", command, program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(read, write),
            stderr=subprocess.DEVNULL,
        )
        os.close(read)
        os.close(write)
        self._buffer, self._count, self._session = b"", 0, ""
        self.troubles: list[str] = []
        self.requests: list[str] = []
        target = self("Target.createTarget", url="about:blank")["targetId"]
        self._session = self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self(f"{domain}.enable")

    def __call__(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._read], [], [], PATIENCE)[0]:
                raise RuntimeError("the browser does not answer")
            part = os.read(self._read, 1 << 20)
            if not part:
                raise RuntimeError("the browser has gone")
            self._buffer += part
        text, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method"), message.get("params", {}))
        return message

    def _note(self, method: str | None, event: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.troubles.append(str(event["exceptionDetails"].get("exception", {}).get("description")))
        elif method == "Runtime.consoleAPICalled" and event["type"] in ("error", "warning"):
            self.troubles.append(str([argument.get("value") for argument in event["args"]]))
        elif method == "Log.entryAdded" and event["entry"]["level"] in ("error", "warning"):
            if not any(word in event["entry"]["text"] for word in ADVICE):
                self.troubles.append(event["entry"]["text"])
        elif method == "Page.javascriptDialogOpening":
            self.troubles.append(f"dialog: {event['message']}")
            # An answer is not waited for: the page stands still until it comes.
            self._count += 1
            message = {
                "id": self._count,
                "method": "Page.handleJavaScriptDialog",
                "params": {"accept": False},
            }
            os.write(self._write, json.dumps({**message, "sessionId": self._session}).encode() + b"\0")
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"][:200])

    @property
    def foreign(self) -> list[str]:
        """Requests for anything but the file itself."""
        return [url for url in self.requests if not url.startswith(LOCAL)]

    def evaluate(self, expression: str) -> Any:
        answer = self("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, expression: str) -> None:
        """Until an expression is true; a selection is drawn within a few frames."""
        begin = time.monotonic()
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > begin + (1.0 if self.troubles else PATIENCE):
                raise AssertionError("\n".join([f"never became true: {expression}", *self.troubles]))
            time.sleep(0.02)

    def open(self, path: Path, width: int = DESKTOP, fragment: str = "") -> None:
        """Load a report and wait until it is drawn; it must fit into the window."""
        self.visit(path, width, fragment)
        self.wait("document.querySelector('#announcement')?.textContent")
        wide = self.evaluate("document.documentElement.scrollWidth")
        assert wide <= width, f"{path.name} is {wide} px wide in a window of {width} px"

    def visit(self, path: Path, width: int = DESKTOP, fragment: str = "") -> None:
        phone = width < 600
        self("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=phone)
        # A new fragment alone would not load the page again.
        self("Page.navigate", url="about:blank")
        self("Page.navigate", url=path.resolve().as_uri() + fragment)

    def shoot(self, path: Path) -> None:
        """The whole page, a moment later: WebGL draws after the page says it is done."""
        time.sleep(0.4)
        size = self("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        image = self("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)["data"]
        path.write_bytes(base64.b64decode(image))

    def printed(self) -> bytes:
        """The page as PDF."""
        return base64.b64decode(self("Page.printToPDF", preferCSSPageSize=True)["data"])

    def press(self, key: str) -> None:
        text = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            code = {"key": key, "code": key, "windowsVirtualKeyCode": KEYS[key]}
            self("Input.dispatchKeyEvent", type=kind, **code, **(text if kind == "keyDown" else {}))

    def click(self, x: float, y: float) -> None:
        self("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def close(self) -> None:
        """End the program, by force where it does not go."""
        try:
            self._session = ""
            self("Browser.close")
            self._process.wait(timeout=20)
        except (RuntimeError, OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._write)
        os.close(self._read)


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser with a profile of its own."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(Path(profile))
        try:
            yield browser
        finally:
            browser.close()


def main() -> None:
    """Save each report as it looks on a desktop, a phone and paper."""
    folder, *reports = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    with browsing() as browser:
        for report in reports:
            name = f"{report.resolve().parent.name}-{report.stem}"
            for width in (PHONE, DESKTOP):
                browser.open(report, width)
                browser.shoot(folder / f"{name}-{width}.png")
            (folder / f"{name}.pdf").write_bytes(browser.printed())
        print("\n".join(browser.troubles + browser.foreign) or f"saved in {folder}")


if __name__ == "__main__":
    main()
