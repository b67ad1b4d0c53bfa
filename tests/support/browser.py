"""Opens HTML files in a real browser: what the console says, what is requested, what is too wide.

    python -m tests.support.browser PAGE.html ... [--shots FOLDER]

Each page is loaded in headless Chromium at 1280 and at 390 pixels width, with every <details>
open.  A page passes if the console stays silent, nothing but the file itself is requested, no
text overflows the width, every picture is shown and has words for those who cannot see it.
Chromium is driven through its own pipe (Chrome DevTools Protocol), so nothing has to be installed.
"""

import argparse
import base64
import fcntl
import json
import os
import shutil
import signal
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
WIDTHS = (1280, 390)
TALLEST = 16000  # pixels of a picture of a page

LOOK = """(() => {
  const wide = [...document.querySelectorAll('body *')]
    .filter(e => !e.closest('.scroll') && e.getBoundingClientRect().right > innerWidth + 1)
    .map(e => e.tagName + ' ' + e.textContent.trim().slice(0, 40));
  const images = [...document.images];
  return JSON.stringify({
    width: document.documentElement.scrollWidth, shown: innerWidth,
    height: document.documentElement.scrollHeight, wide: wide.slice(0, 5),
    images: images.length, broken: images.filter(i => !i.complete || !i.naturalWidth).length,
    wordless: images.filter(i => !i.alt.trim()).length,
    title: document.title, text: document.body.innerText.length,
    scripts: document.scripts.length,
  });
})()"""


@dataclass
class Seen:
    """What one page did at one width."""

    page: str
    width: int
    console: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    layout: dict = field(default_factory=dict)

    def problems(self) -> list[str]:
        """What is wrong, in words; empty for a page that passes."""
        layout = self.layout
        found = [f"console: {line}" for line in self.console]
        found += [f"request: {address[:120]}" for address in self.requests]
        if layout["width"] > layout["shown"]:
            found.append(f"{layout['width']} pixels wide on {layout['shown']}: {layout['wide']}")
        for key in ("broken", "wordless"):
            if layout[key]:
                found.append(f"{layout[key]} of {layout['images']} pictures are {key}")
        if not layout["title"] or not layout["text"]:
            found.append("the page is empty")
        return found


class Browser:
    """Headless Chromium with its DevTools on file descriptors 3 and 4; a context manager."""

    def __init__(self, program: str):
        # Chromium's children may still write there when it has ended.
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        command = [
            program, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
            "--no-first-run", "--disable-extensions", "--disable-component-update",
            f"--user-data-dir={self._profile.name}", "about:blank",
        ]  # fmt: skip
        self._process = _started(command, to_read, to_write)
        os.close(to_read)
        os.close(to_write)
        self._buffer, self._number, self._session = b"", 0, ""
        self.events: list[dict] = []
        pages = self.ask("Target.getTargets")["targetInfos"]
        target = next(page["targetId"] for page in pages if page["type"] == "page")
        found = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = found["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_) -> None:
        os.kill(self._process, signal.SIGTERM)
        os.waitpid(self._process, 0)
        os.close(self._write)
        os.close(self._read)
        self._profile.cleanup()

    def ask(self, method: str, **parameters) -> dict:
        """The browser's answer to one command; events meanwhile are kept in `events`."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def wait_for(self, method: str) -> None:
        """Until the browser has reported an event."""
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self._next())

    def evaluate(self, expression: str):
        """The value of a JavaScript expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def _next(self) -> dict:
        while b"\0" not in self._buffer:
            part = os.read(self._read, 1 << 16)
            if not part:
                raise RuntimeError("the browser has gone")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)


def _started(command: list[str], to_read: int, to_write: int) -> int:
    """The process of a command that reads at descriptor 3 and writes at 4, otherwise silent."""
    high = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (to_read, to_write)]
    actions = [(os.POSIX_SPAWN_OPEN, out, os.devnull, os.O_WRONLY, 0) for out in (1, 2)]
    moves = [(os.POSIX_SPAWN_DUP2, end, place) for end, place in zip(high, (3, 4), strict=True)]
    process = os.posix_spawn(command[0], command, os.environ, file_actions=[*actions, *moves])
    for end in high:
        os.close(end)
    return process


def look(browser: Browser, page: Path, width: int, shot: Path | None = None) -> Seen:
    """One page at one width, all its details open; a picture of it in `shot`."""
    browser.events.clear()
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.ask("Emulation.setDeviceMetricsOverride", **size)
    browser.ask("Page.navigate", url=page.resolve().as_uri())
    browser.wait_for("Page.loadEventFired")
    browser.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    seen = Seen(page.name, width, layout=json.loads(browser.evaluate(LOOK)))
    if shot is not None:
        height = min(seen.layout["height"], TALLEST)
        browser.ask("Emulation.setDeviceMetricsOverride", **{**size, "height": height})
        taken = browser.ask("Page.captureScreenshot", format="png")
        shot.write_bytes(base64.b64decode(taken["data"]))
    for event in browser.events:
        _note(seen, event, page)
    return seen


def _note(seen: Seen, event: dict, page: Path) -> None:
    """Keeps what an event says about console and network."""
    method, content = event.get("method"), event.get("params", {})
    if method == "Log.entryAdded":
        seen.console.append(content["entry"]["text"])
    elif method == "Runtime.consoleAPICalled":
        seen.console.append(str(content["args"]))
    elif method == "Runtime.exceptionThrown":
        seen.console.append(content["exceptionDetails"]["text"])
    elif method == "Network.requestWillBeSent":
        address = content["request"]["url"]
        if address != page.resolve().as_uri() and not address.startswith("data:"):
            seen.requests.append(address)


def program() -> str | None:
    """The browser that is installed, if any."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", type=Path, nargs="+")
    parser.add_argument("--shots", type=Path, help="folder for pictures of the pages")
    chosen = parser.parse_args()
    found = program()
    if found is None:
        sys.exit(f"none of {', '.join(NAMES)} is installed")
    failed = False
    if chosen.shots:
        chosen.shots.mkdir(parents=True, exist_ok=True)
    with Browser(found) as browser:
        for page in chosen.pages:
            for width in WIDTHS:
                shot = chosen.shots and chosen.shots / f"{page.parent.name}_{page.stem}_{width}.png"
                seen = look(browser, page, width, shot)
                problems = seen.problems()
                failed |= bool(problems)
                words = "; ".join(problems) or f"passes with {seen.layout['images']} pictures"
                print(f"{page} at {width} pixels: {words}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
