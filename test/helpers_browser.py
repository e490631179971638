"""A page in headless Chromium that tests click on, over the DevTools protocol's pipe."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

CHROMIUM = next(
    (path for path in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if path),
    None,
)
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
_PROJECT = """
(() => {
  const plot = document.getElementById("plot"), scene = plot._fullLayout.scene._scene;
  const {model, view, projection} = scene.glplot.cameraParams, scale = scene.dataScale;
  const four = [0, 1, 2, 3];
  const times = (m, v) => four.map(r => four.reduce((sum, c) => sum + m[4 * c + r] * v[c], 0));
  const place = PLACE.map((v, k) => v * scale[k]);
  const [x, y, , w] = times(projection, times(view, times(model, [...place, 1])));
  const box = scene.glplot.canvas.getBoundingClientRect();
  return [box.left + box.width * (1 + x / w) / 2, box.top + box.height * (1 - y / w) / 2];
})()
"""


class BrowserPage:
    """An open page, drawn; `with BrowserPage(path, "room=3") as page` closes the browser again."""

    def __init__(self, page: Path, address: str = "") -> None:
        flags = [*FLAGS, f"--user-data-dir={page.with_name('profile')}", "--window-size=1200,800"]
        # Chromium reads commands from descriptor 3 and answers on 4.
        command = 'exec "$@" 3<&0 4>&1 </dev/null >/dev/null'
        self._process = subprocess.Popen(
            ["sh", "-c", command, "sh", str(CHROMIUM), *flags, "--remote-debugging-pipe"],
            **{"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._out, self._in = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._buffer, self._count, self._session = b"", 0, ""
        opened = self._call("Target.createTarget", url=f"{page.as_uri()}#{address}")
        target = {"targetId": opened["targetId"], "flatten": True}
        self._session = self._call("Target.attachToTarget", **target)["sessionId"]
        self.wait_for("document.body?.dataset.state === 'drawn'")

    def __enter__(self) -> BrowserPage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.communicate(timeout=300)

    def value(self, expression: str) -> Any:
        """Return what an expression is in the page."""
        answer = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, expression: str, seconds: float = 300.0) -> None:
        """Return as soon as an expression is true in the page."""
        end = time.monotonic() + seconds
        while not self.value(f"!!({expression})"):
            assert time.monotonic() < end, f"not in {seconds} s: {expression}"
            time.sleep(0.1)

    def pixel(self, place: list[float]) -> tuple[float, float]:
        """Return where the 3D scene shows a place of the map."""
        x, y = self.value(_PROJECT.replace("PLACE", json.dumps(place)))
        return x, y

    def press(self, x: float, y: float) -> None:
        """Move the mouse to a pixel and press its left button."""
        self._mouse("mouseMoved", x, y, "none")
        self._mouse("mousePressed", x, y, "left")

    def release(self, x: float, y: float) -> None:
        """Let the button go again."""
        self._mouse("mouseReleased", x, y, "left")

    def _mouse(self, kind: str, x: float, y: float, button: str) -> None:
        # The command's own parameter `type` says what the mouse does.
        self._call(
            "Input.dispatchMouseEvent",
            **{"type": kind, "x": x, "y": y, "button": button, "clickCount": 1},
        )

    def _call(self, method: str, **values: Any) -> Any:
        self._count += 1
        message = {"id": self._count, "method": method, "params": values}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]

    def _next(self) -> Any:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], 300.0)
            assert ready, "the browser does not answer"
            data = os.read(self._in, 1 << 16)
            assert data, "the browser has ended"
            self._buffer += data
        text, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(text)
