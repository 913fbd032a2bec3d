"""The only import of OMPL, shielded from signals: an exception during its loading would end the process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _signals_afterwards() -> Iterator[None]:
    """Defer signals within the block to its end."""
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread only, so none interrupts this one
        return
    arrived: list[int] = []
    handlers = {number: handler for number in signal.valid_signals() if callable(handler := signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda number, _: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for late in arrived:
            signal.raise_signal(late)


with _signals_afterwards():
    from ompl import base, geometric, util

__all__ = ["base", "geometric", "util"]
