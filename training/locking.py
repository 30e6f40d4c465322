"""One writer at a time for a file that several processes append to."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["alone"]

_WAIT_S = 0.02

if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> None:
        while True:
            try:
                return msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            except OSError:
                time.sleep(_WAIT_S)

else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX)


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file, waiting for whoever has it; the system frees it when a process dies.

    Args:
        path: the file to be replaced; the lock is ``<name>.lock`` beside it, for a replaced file takes its own along.

    Raises:
        OSError: the folder cannot be written to, or its file system knows no locks.
    """
    lock = path.with_name(f"{path.name}.lock")
    held = False
    while not held:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _take(descriptor)
            # Whoever held it before may have removed the name: then ours is a lock that nobody else sees.
            held = _same(descriptor, lock)
            if held:
                yield
        finally:
            if held and sys.platform != "win32":
                lock.unlink(missing_ok=True)
            os.close(descriptor)


def _same(descriptor: int, lock: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), lock.stat())
    except FileNotFoundError:
        return False
