"""Rows to a file while they are computed: whole cells, often enough to lose little, seldom enough to cost little."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from types import TracebackType

import pandas as pd

from jink.training.rows import append_rows

__all__ = ["RowWriter", "remove_leftovers"]

_SHARE = 10.0
"""Writing takes at most about one part in so many of the time."""


class RowWriter:
    """Collects finished cells and appends them; what is collected is written when the block ends, however it ends.

    Args:
        path: the Parquet file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._waiting: list[pd.DataFrame] = []
        self._next = 0.0

    def __enter__(self) -> RowWriter:
        return self

    def add(self, rows: pd.DataFrame) -> None:
        """Take the rows of one cell.

        Raises:
            OSError: they cannot be written.
        """
        self._waiting.append(rows)
        if time.monotonic() >= self._next:
            self.flush()

    def flush(self) -> None:
        """Write what has been collected."""
        if not self._waiting:
            return
        began = time.monotonic()
        rows = pd.concat(self._waiting, ignore_index=True)
        try:
            append_rows(self.path, rows)
        except OSError as error:
            self._waiting = []
            reason = os.strerror(error.errno).lower() if error.errno else " ".join(str(error).split())
            raise OSError(
                f"--out: rows must fit on the disk of {self.path.name}; got an error while writing ({reason}). "
                "What the file held before is complete: make room and give the same command again."
            ) from error
        self._waiting = []
        ended = time.monotonic()
        self._next = ended + _SHARE * (ended - began)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.flush()


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes left half written beside a file."""
    for part in path.parent.glob(f"{path.name}.*.part"):
        number = part.name.removeprefix(f"{path.name}.").removesuffix(".part")
        if number.isdigit() and not _alive(int(number)):
            part.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if sys.platform == "win32":
        return True  # there, signal 0 is Ctrl-C
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
