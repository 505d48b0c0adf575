"""Screenshots by a headless Chromium through its WebDriver, where both are installed."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.request

MISSING = shutil.which("chromedriver") is None or not any(map(shutil.which, ("chromium", "google-chrome")))
SOFTWARE = (
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
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        return json.load(answer)["value"]


def screenshot(url, path, ready, size=(640, 400)):
    """Open a page, wait until the JavaScript expression `ready` is true, and write a picture of it."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    driver = subprocess.Popen(["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    base = f"http://127.0.0.1:{port}"
    session = ""
    try:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                call(f"{base}/status", method="GET")
                break
            except OSError:
                time.sleep(0.05)
        chrome = {"args": [*SOFTWARE, f"--window-size={size[0]},{size[1]}"]}
        wanted = {"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": chrome}}}
        session = f"{base}/session/{call(f'{base}/session', wanted)['sessionId']}"
        call(f"{session}/url", {"url": url})
        while time.monotonic() < end:
            if call(f"{session}/execute/sync", {"script": f"return {ready}", "args": []}):
                break
            time.sleep(0.2)
        path.write_bytes(base64.b64decode(call(f"{session}/screenshot", method="GET")))
    finally:
        if session:
            call(session, method="DELETE")
        driver.terminate()
        driver.wait(10)
