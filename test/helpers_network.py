"""Two network namespaces with a bad radio between them, without netem: a relay of two TAP devices.

The relay reads each end's frames and passes them on late, out of order, at a limited rate, or not
at all. It needs root, `ip` and /dev/net/tun; :func:`missing` says what is lacking.
"""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import os
import random
import secrets
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

_TUNSETIFF = 0x400454CA
_TAP_WITHOUT_HEADER = 0x0002 | 0x1000
_FRAME = 65_536
_QUEUED = 200_000
"""Bytes that wait for a limited rate at most, as in a radio's buffer; then frames are lost."""


def missing() -> str:
    """Return why namespaces cannot be made here, or an empty string."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "no ip (iproute2)"
    if not Path("/dev/net/tun").exists():
        return "no /dev/net/tun"
    name = f"tm{secrets.token_hex(3)}t"
    tried = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if tried.returncode != 0:
        return f"network namespaces are not allowed: {tried.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", name], check=True)
    return ""


class Radio:
    """The link between the namespaces; its faults may be changed while it carries frames."""

    def __init__(self, ends: tuple[int, int], seed: int = 0) -> None:
        self.loss = 0.0
        self.delay_s = 0.0
        self.jitter_s = 0.0
        """Frames are late by up to this much more, each by itself, so they overtake each other."""
        self.rate_bps = float("inf")
        self.cut = False
        self.passed = [0, 0]
        """Bytes that went over, by direction."""
        self.lost = 0
        self._ends = ends
        self._random = random.Random(seed)
        self._free = [0.0, 0.0]
        self._stopping = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop carrying frames."""
        self._stopping = True
        self._thread.join()

    def _run(self) -> None:
        due: list[tuple[float, int, int, bytes]] = []
        count = 0
        while not self._stopping:
            wait = min(0.05, max(0.0, due[0][0] - time.monotonic())) if due else 0.05
            readable, _, _ = select.select(self._ends, [], [], wait)
            for end in readable:
                side = self._ends.index(end)
                frame = os.read(end, _FRAME)
                at = self._arrival(side, len(frame))
                if at is None:
                    self.lost += 1
                    continue
                count += 1
                heapq.heappush(due, (at, count, 1 - side, frame))
            while due and due[0][0] <= time.monotonic():
                _, _, to, frame = heapq.heappop(due)
                self.passed[1 - to] += len(frame)
                with contextlib.suppress(OSError):
                    os.write(self._ends[to], frame)

    def _arrival(self, side: int, size: int) -> float | None:
        """Return when a frame arrives at the other end, None where it is lost."""
        now = time.monotonic()
        if self.cut or self._random.random() < self.loss:
            return None
        sent = max(now, self._free[side])
        if (sent - now) * self.rate_bps / 8 > _QUEUED:
            return None
        if self.rate_bps != float("inf"):
            sent += size * 8 / self.rate_bps
            self._free[side] = sent
        return sent + self.delay_s + self._random.random() * self.jitter_s


def _tap(name: str, namespace: str, address: str) -> int:
    end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(end, _TUNSETIFF, struct.pack("16sH", name.encode(), _TAP_WITHOUT_HEADER))
    for command in (
        ["ip", "link", "set", name, "netns", namespace],
        ["ip", "-n", namespace, "addr", "add", f"{address}/24", "dev", name],
        ["ip", "-n", namespace, "link", "set", name, "up"],
        ["ip", "-n", namespace, "link", "set", "lo", "up"],
        ["ip", "-n", namespace, "route", "add", "224.0.0.0/4", "dev", name],
    ):
        subprocess.run(command, check=True, capture_output=True)
    return end


@contextlib.contextmanager
def namespaces(seed: int = 0) -> Iterator[tuple[tuple[str, str], Radio]]:
    """Yield the names of two namespaces and the radio between them; all of it is gone after."""
    stem = f"tm{secrets.token_hex(3)}"  # An interface's name has 15 letters at most.
    names = (f"{stem}a", f"{stem}b")
    ends: list[int] = []
    try:
        for number, name in enumerate(names, 1):
            subprocess.run(["ip", "netns", "add", name], check=True, capture_output=True)
            ends.append(_tap(f"{name}0", name, f"10.77.0.{number}"))
        radio = Radio((ends[0], ends[1]), seed)
        try:
            yield names, radio
        finally:
            radio.close()
    finally:
        for end in ends:
            os.close(end)
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)
