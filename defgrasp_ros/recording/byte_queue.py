"""A queue between threads that is bounded by the size of what is in it."""

from __future__ import annotations

import time
from collections import deque
from threading import Condition
from typing import Generic, TypeVar

Item = TypeVar("Item")


class ByteQueue(Generic[Item]):
    """First in, first out; whoever puts more than fits waits until there is room.

    Args:
        limit: Total size of the items that may wait [B]; a single larger one is let in when nothing else waits.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._items: deque[tuple[Item, int]] = deque()
        self._changed = Condition()
        self._closed = False
        self._size = 0
        self._waiting_time = 0.0

    @property
    def size(self) -> int:
        """Total size of the items that wait now [B]."""
        return self._size

    @property
    def waiting_time(self) -> float:
        """How long ``put`` has waited for room, all calls together [s]."""
        return self._waiting_time

    @property
    def finished(self) -> bool:
        """Whether the queue is closed and everything was taken out."""
        with self._changed:
            return self._closed and not self._items

    def put(self, item: Item, size: int) -> bool:
        """Append an item when there is room for it.

        Returns:
            Whether it was appended; False when the queue is closed, or was while this waited.
        """
        with self._changed:
            if not self._has_room(size):
                start = time.monotonic()
                self._changed.wait_for(lambda: self._has_room(size))
                self._waiting_time += time.monotonic() - start
            if self._closed:
                return False
            self._items.append((item, size))
            self._size += size
            self._changed.notify_all()
            return True

    def get(self, timeout: float) -> Item | None:
        """Take the first item out; None if there is none within ``timeout`` [s], or if the queue is finished."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed, timeout)
            if not self._items:
                return None
            item, size = self._items.popleft()
            self._size -= size
            self._changed.notify_all()
            return item

    def close(self, *, discard: bool = False) -> None:
        """Take no more items; those that wait can still be taken out, unless they are discarded."""
        with self._changed:
            self._closed = True
            if discard:
                self._items.clear()
                self._size = 0
            self._changed.notify_all()

    def _has_room(self, size: int) -> bool:
        return self._closed or not self._items or self._size + size <= self._limit
