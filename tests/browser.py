"""A real browser for tests: headless Chromium driven over its pipe, with everything it complains of and asks for."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WAIT_S = 60.0


def find_browser() -> str | None:
    """The program, or None: set JINK_BROWSER to one of another name."""
    named = os.environ.get("JINK_BROWSER")
    return named or next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One tab. `errors`: script errors and complaints of the console; `requests`: addresses it asked for."""

    def __init__(self, send, receive, session):
        self._send, self._receive, self._session = send, receive, session
        self.errors, self.requests = [], []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        number = self._send({"method": method, "params": params, "sessionId": self._session})
        while True:
            message = self._receive()
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._note(message)

    def _note(self, message):
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            detail = params["exceptionDetails"]
            self.errors.append(detail.get("exception", {}).get("description", detail["text"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.errors.append(str([a.get("value", a.get("description")) for a in params["args"]]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def resize(self, width, height, mobile=False, scale=1):
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=mobile
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=mobile)

    def prefer(self, scheme):
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def open(self, path, ready="document.readyState === 'complete'"):
        address = path.resolve().as_uri() if isinstance(path, Path) else path
        self.call("Page.navigate", url=address)
        self.wait(ready)

    def run(self, script):
        """The value of an expression; promises are awaited."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"].get("exception", {}).get("description", str(found)))
        return found["result"].get("value")

    def wait(self, script, seconds=WAIT_S):
        until = time.monotonic() + seconds
        # While a page is being replaced there may be no document to ask.
        while not self.run(f"(() => {{ try {{ return Boolean({script}); }} catch {{ return false; }} }})()"):
            if time.monotonic() > until:
                raise TimeoutError(f"{script} did not become true within {seconds:g} s; errors: {self.errors}")
            time.sleep(0.05)

    def picture(self, path, whole=False):
        found = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(found["data"]))


@contextlib.contextmanager
def open_page(folder):
    """A tab of a browser that cannot reach any network; its profile lies in a folder."""
    program = find_browser()
    assert program is not None
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()

    def wire():
        os.dup2(to_browser, 3)
        os.dup2(from_browser, 4)

    # Descriptors 3 and 4 may be those of the pipes themselves: move all out of the way first.
    to_browser, from_browser = os.dup(to_browser), os.dup(from_browser)
    process = subprocess.Popen(
        [program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
         "--disable-background-networking", "--disable-component-update",
         "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
         f"--user-data-dir={folder}", "--remote-debugging-pipe", "about:blank"],
        preexec_fn=wire,  # noqa: PLW1509 - two dup2 and nothing else
        close_fds=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    counter, rest = itertools.count(1), bytearray()
    os.close(from_browser)

    def send(message):
        number = next(counter)
        data = json.dumps({"id": number, **message}).encode() + b"\0"
        while data:
            data = data[os.write(from_us, data) :]
        return number

    def receive():
        while b"\0" not in rest:
            got = os.read(to_us, 1 << 20)
            if not got:
                raise RuntimeError("the browser has ended")
            rest.extend(got)
        message, _, after = bytes(rest).partition(b"\0")
        rest[:] = after
        return json.loads(message)

    def ask(method, **params):
        number = send({"method": method, "params": params})
        while (message := receive()).get("id") != number:
            pass
        return message["result"]

    try:
        target = next(t for t in ask("Target.getTargets")["targetInfos"] if t["type"] == "page")["targetId"]
        session = ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        yield Page(send, receive, session)
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for end in (from_us, to_us, to_browser):
            os.close(end)
