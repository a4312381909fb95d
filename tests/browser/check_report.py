"""Open reports in a headless Chromium, use them by mouse, keyboard and address, and save what is seen.

Usage: python tests/browser/check_report.py [FOLDER]

Fails on a console error, on a request for anything but the file, on text wider than the window, and when a
selection does not change what follows it. Screenshots and a PDF go to FOLDER (default: a new temporary one).
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

import test_report as fake  # noqa: E402

from fosopt.report import write_report  # noqa: E402

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
    "--hide-scrollbars",
    "--remote-debugging-pipe",
]

# Advice on speed, given when a browser draws without a graphics card; that is not the page's matter.
ADVICE = ("WebGL", "GL Driver", "willReadFrequently")


class Browser:
    """A Chromium driven over a pair of pipes by the DevTools protocol."""

    def __init__(self, profile: Path) -> None:
        program = shutil.which("chromium") or shutil.which("google-chrome")
        if program is None:
            raise SystemExit("no Chromium on the PATH; install the package chromium")
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
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"][:200])

    def evaluate(self, expression: str) -> Any:
        answer = self("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, expression: str) -> None:
        """Until an expression is true; a selection is drawn within a few frames."""
        deadline = time.monotonic() + 30
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > deadline:
                raise AssertionError(f"never became true: {expression}")
            time.sleep(0.05)

    def open(self, path: Path, width: int, fragment: str = "") -> None:
        phone = width < 600
        self("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=phone)
        # A new fragment alone would not load the page again.
        self("Page.navigate", url="about:blank")
        self("Page.navigate", url=path.as_uri() + fragment)
        self.wait("document.querySelector('#announcement')?.textContent")
        wide = self.evaluate("document.documentElement.scrollWidth")
        assert wide <= width, f"{path.name} is {wide} px wide in a window of {width} px"

    def shoot(self, path: Path) -> None:
        """The whole page, a moment later: WebGL draws after the page says it is done."""
        time.sleep(0.4)
        size = self("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        image = self("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)["data"]
        path.write_bytes(base64.b64decode(image))

    def print(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self("Page.printToPDF", preferCSSPageSize=True)["data"]))

    def press(self, key: str) -> None:
        code = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}[key]
        for kind in ("keyDown", "keyUp"):
            self("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def click(self, x: float, y: float) -> None:
        self("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def close(self) -> None:
        self("Browser.close")
        self._process.wait(timeout=20)


def selected(key: str) -> str:
    return f"document.querySelector('#announcement').textContent.startsWith('Point {key} selected')"


# What the figures below the front show, in one comparable text.
LINKED = """JSON.stringify(['structure', 'bode', 'sensitivity', 'jitter', 'cumulative', 'history'].map(
    (id) => document.getElementById(id).data.map(({ x, y }) => [[...x].slice(0, 40), [...y].slice(0, 40)])
))"""


def check_front(browser: Browser, folder: Path) -> None:
    path = folder / "front.html"
    write_report(fake.fake_run(), path)
    browser.open(path, 1280)
    assert browser.evaluate("document.querySelector('h1').textContent") == fake.HOSTILE
    assert browser.evaluate("document.title").startswith(fake.HOSTILE)
    browser.shoot(folder / "desktop.png")

    browser.open(path, 1280, "#point=003")
    browser.wait(selected("003"))
    before = browser.evaluate(LINKED)

    place = browser.evaluate("""(() => {
        const gd = document.getElementById('front'), box = gd.getBoundingClientRect();
        const trace = gd.data.findIndex((one) => one.customdata?.includes('005'));
        const at = gd.data[trace].customdata.indexOf('005'), { xaxis, yaxis } = gd._fullLayout;
        return [box.left + xaxis._offset + xaxis.d2p(gd.data[trace].x[at]),
                box.top + yaxis._offset + yaxis.d2p(gd.data[trace].y[at])];
    })()""")
    browser.click(*place)
    browser.wait(selected("005"))
    assert browser.evaluate("location.hash") == "#point=005"
    clicked = browser.evaluate(LINKED)
    same = [i for i, (a, b) in enumerate(zip(json.loads(before), json.loads(clicked), strict=True)) if a == b]
    assert not same, f"figures {same} do not follow the selection"

    browser.evaluate("document.querySelector('#points tr[data-key=\"005\"] button').focus()")
    browser.press("ArrowDown")
    browser.wait(selected("006"))
    assert browser.evaluate("document.activeElement.dataset.key") == "006"
    browser.press("ArrowUp")
    browser.press("ArrowUp")
    browser.wait(selected("004"))
    browser.evaluate("document.getElementById('next').focus()")
    browser.press("ArrowRight")
    browser.wait(selected("005"))
    assert browser.evaluate(LINKED) == clicked

    browser.evaluate("location.hash = '#point=011'")
    browser.wait(selected("011"))
    assert "18.2 Hz" in browser.evaluate("document.querySelector('#reason').innerText")
    rows = browser.evaluate("[...document.querySelectorAll('#metrics tr')].map((row) => row.innerText)")
    jitter = [row for row in rows if "jitter" in row.lower()]
    assert jitter and all("–" in row for row in jitter)
    hidden = "['jitter', 'cumulative', 'step'].every((id) => document.getElementById(id + '-panel').hidden)"
    assert browser.evaluate(hidden)
    browser.shoot(folder / "unstable.png")
    browser.evaluate("location.hash = '#point=004'")
    browser.wait(selected("004"))
    assert not browser.evaluate(hidden)
    browser.print(folder / "front.pdf")
    browser.open(path, 390, "#point=003")
    browser.shoot(folder / "phone.png")


def check_others(browser: Browser, folder: Path) -> None:
    runs = {"cases": fake.single_run(), "spatial": fake.spatial_run(), "large": fake.large_run(10_001)}
    for name, run in runs.items():
        path = folder / f"{name}.html"
        write_report(run, path)
        for width in (1280, 390):
            browser.open(path, width)
            browser.shoot(folder / f"{name}_{width}.png")
            if name == "cases":
                # plotly would read the tags of a name in a figure as its own.
                assert "<b>free</b>" in browser.evaluate("document.getElementById('front').textContent")
    write_report({}, folder / "empty.html")
    browser("Page.navigate", url=(folder / "empty.html").as_uri())
    browser.wait("document.getElementById('summary')?.textContent.includes('no points')")


def main() -> None:
    """Run all checks."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="fosopt_report_"))
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(Path(profile))
        try:
            check_front(browser, folder)
            check_others(browser, folder)
        finally:
            browser.close()
    foreign = [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:", "about:"))]
    assert not foreign, foreign
    assert not browser.troubles, "\n".join(browser.troubles)
    print(f"the reports work; screenshots in {folder}")


if __name__ == "__main__":
    main()
