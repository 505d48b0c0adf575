"""A headless Chromium through its WebDriver, where both are installed: what a page shows, and what people do to it."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request

MISSING = shutil.which("chromedriver") is None or not any(map(shutil.which, ("chromium", "google-chrome")))
PLAIN = ("--headless=new", "--no-sandbox", "--disable-gpu")
SOFTWARE = (  # WebGL on the CPU, which makes everything else slow
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
PATIENCE = 120  # s, of a machine that has much to do


def call(url, body=None, method="POST"):
    data = None if method == "GET" else json.dumps(body or {}).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return json.load(answer)["value"]
    except urllib.error.HTTPError as error:
        raise RuntimeError(error.read().decode()[:500]) from error


class Browser:
    """A window of this size, as a context.

    Args:
        size: of the window [pixels].
        arguments: of Chromium.
        downloads: the folder that takes what is downloaded.
    """

    def __init__(self, size=(640, 400), arguments=PLAIN, downloads=None):
        self.size, self.arguments, self.downloads = size, arguments, downloads

    def __enter__(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.driver = subprocess.Popen(
            ["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.session, base = "", f"http://127.0.0.1:{port}"
        try:
            end = time.monotonic() + PATIENCE
            while time.monotonic() < end:
                try:
                    call(f"{base}/status", method="GET")
                    break
                except OSError:
                    time.sleep(0.05)
            chrome = {"args": [*self.arguments, f"--window-size={self.size[0]},{self.size[1]}"]}
            if self.downloads is not None:
                chrome["prefs"] = {
                    "download.default_directory": str(self.downloads),
                    "profile.default_content_setting_values.automatic_downloads": 1,  # several, without asking
                }
            wanted = {"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": chrome}}}
            self.session = f"{base}/session/{call(f'{base}/session', wanted)['sessionId']}"
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        if self.session:
            call(self.session, method="DELETE")
        self.driver.terminate()
        self.driver.wait(10)

    def open(self, url):
        call(f"{self.session}/url", {"url": url})

    def run(self, script, *arguments):
        """The value of a JavaScript expression, in which `arguments` stands for these."""
        return call(f"{self.session}/execute/sync", {"script": f"return {script}", "args": arguments})

    def until(self, script, *arguments, patience=PATIENCE):
        """Wait until an expression is true."""
        end = time.monotonic() + patience
        while not (found := self.run(script, *arguments)):
            assert time.monotonic() < end, f"it never came: {script}"
            time.sleep(0.05)
        return found

    def picture(self, path):
        path.write_bytes(base64.b64decode(call(f"{self.session}/screenshot", method="GET")))

    def pointer(self, *actions, kind="mouse"):
        """Real events of a pointer: `(x, y)` to go there, `(x, y, milliseconds)` to take this long, "down" and "up"."""
        words = {"down": {"type": "pointerDown", "button": 0}, "up": {"type": "pointerUp", "button": 0}}
        made = []
        for action in actions:
            if isinstance(action, str):
                made.append(words[action])
            else:
                x, y, *rest = action
                made.append({"type": "pointerMove", "x": round(x), "y": round(y), "duration": rest[0] if rest else 0})
        source = {"type": "pointer", "id": kind, "parameters": {"pointerType": kind}, "actions": made}
        call(f"{self.session}/actions", {"actions": [source]})

    def press(self, *keys):
        """Keys, one after the other."""
        made = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        call(f"{self.session}/actions", {"actions": [{"type": "key", "id": "keys", "actions": made}]})


def screenshot(url, path, ready, size=(640, 400)):
    """Open a page, wait until the JavaScript expression `ready` is true, and write a picture of it."""
    with Browser(size, SOFTWARE) as browser:
        browser.open(url)
        browser.until(ready)
        browser.picture(path)
