"""Work off the callback thread: a bounded inbox whose newest content wins, and its one thread."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

logger = logging.getLogger(__name__)

ItemT = TypeVar("ItemT")


class Inbox(Generic[ItemT]):
    """The newest `capacity` items that nobody has taken yet; older ones are dropped and counted.

    With `capacity` 1 it is a slot in which the latest wins.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._items: deque[ItemT] = deque()
        self._lock = threading.Lock()
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """How many items were pushed out by newer ones before they were taken."""
        return self._dropped

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: ItemT) -> None:
        """Add an item; the oldest leaves when the inbox is full."""
        with self._lock:
            while len(self._items) >= self.capacity:
                self._items.popleft()
                self._dropped += 1
            self._items.append(item)

    def take_all(self) -> list[ItemT]:
        """Take what is there, oldest first."""
        with self._lock:
            items = list(self._items)
            self._items.clear()
            return items


class Pace:
    """When something costly is due again: so many times a second at most, and with breaks between.

    Parameters
    ----------
    share : of the time that it may take at most, its own and the breaks' together
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._next = -float("inf")

    def due(self) -> bool:
        """Whether it may be done now."""
        return time.monotonic() >= self._next

    @contextmanager
    def step(self, rate: float) -> Iterator[None]:
        """Do it once; `rate` is how often (Hz) it may be done at most."""
        began = time.monotonic()
        try:
            yield
        finally:
            took = time.monotonic() - began
            self._next = began + max(1.0 / rate, took / self._share)


class Worker:
    """One thread that calls `work` when woken, and again if it was woken meanwhile.

    An exception in `work` is handed to `failed` and ends that call only.
    """

    def __init__(self, work: Callable[[], None], failed: Callable[[Exception], None]) -> None:
        self._work = work
        self._failed = failed
        self._wanted = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="topometric-worker", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Have `work` called once more, soon; waking twice before that is one call."""
        self._wanted.set()

    def stop(self, timeout_s: float) -> bool:
        """Stop after the present call of `work`; return whether it ended within `timeout_s`."""
        self._stopping = True
        self._wanted.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            if self._stopping:
                return
            try:
                self._work()
            except Exception as error:  # the node must live on; the error is reported, not lost
                if self._stopping:
                    return
                self._failed(error)
