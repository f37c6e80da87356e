"""Keys pressed in the terminal while a command runs."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

POLL_INTERVAL = 0.05
"""Longest wall time that the end of the block waits for the keyboard [s]."""


@contextmanager
def on_key(key: str, action: Callable[[], None]) -> Iterator[None]:
    """Call ``action`` whenever ``key`` is pressed, until the end of the block; without effect without a terminal."""
    if not sys.stdin.isatty():
        yield
        return
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    ended = Event()

    def listen() -> None:
        while not ended.is_set():
            if select.select([keyboard], [], [], POLL_INTERVAL)[0]:
                pressed = os.read(keyboard, 64)
                for _ in range(pressed.count(key.encode())):
                    action()
                if not pressed:  # the terminal is gone
                    return

    listener = Thread(target=listen, name="keyboard", daemon=True)
    tty.setcbreak(keyboard)
    listener.start()
    try:
        yield
    finally:
        ended.set()
        listener.join()
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)
