"""What a running fit says, where it can be seen: a bar or lines on stderr, a file that survives a kill, TensorBoard."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from jink.intent.progress import Progress
from jink.training.console import stderr

__all__ = ["TrainingLog", "describe_progress", "make_board"]

Said = tuple[str, int, int, float, bool]
"""Stage, step, intents, nats per row, whether of tracks held out."""
_EVERY_S = 20.0
"""Without a terminal a line appears at every new stage, and at most this often within one."""


class TrainingLog:
    """Receives the reports of a learner; use it as a context and hand it to ``progress=``.

    Args:
        path: JSON lines, appended; those of an earlier, killed run are kept.
        board: folder of TensorBoard's events, written where it is installed.
    """

    def __init__(self, path: Path, board: Path) -> None:
        self._path, self._board_folder = path, board
        # In order of their first time: a learner that goes on repeats what it said last, to the same bits.
        self._known = dict.fromkeys(_read(path))
        self._began = self._said = time.monotonic()
        self._stage = ""
        self._terminal = sys.stderr.isatty()
        self._bar = Bar(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[said]}"),
            TimeElapsedColumn(),
            console=stderr(),
            transient=True,
            disable=not self._terminal,
        )
        self._task = self._bar.add_task("begins", total=None, said="")
        self._file: TextIO | None = None
        self._board: Any = None

    def __enter__(self) -> TrainingLog:
        self._begin_file()
        self._board = make_board(self._board_folder)
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
        if self._file is not None:
            self._file.close()
        if self._board is not None:
            self._board.close()

    def __call__(self, report: Progress) -> None:
        """Take one report."""
        self._show(report)
        if not math.isfinite(report.log_likelihood):
            return
        if self._board is not None:
            self._board.add_scalar(f"{report.stage}/nats per row", report.log_likelihood, report.step)
            self._board.add_scalar(f"{report.stage}/intents", report.intents, report.step)
        said = (report.stage, report.step, report.intents, float(report.log_likelihood), bool(report.held_out))
        if said not in self._known and self._file is not None:
            self._known[said] = None
            self._file.write(json.dumps(said) + "\n")
            self._file.flush()

    def trace(self) -> list[Progress]:
        """Every report that had a likelihood, in order; what a killed run said included."""
        return [Progress(stage, step, 0, intents, nats, held) for stage, step, intents, nats, held in self._known]

    def _begin_file(self) -> None:
        """A file of what is known so far, open for more; without the line that a kill cut short."""
        part = self._path.with_name(f".{self._path.name}.part")
        part.write_text("".join(json.dumps(line) + "\n" for line in self._known), encoding="utf-8")
        part.replace(self._path)
        self._file = self._path.open("a", encoding="utf-8")

    def _show(self, report: Progress) -> None:
        said = describe_progress(report)
        if self._terminal:
            self._bar.update(
                self._task, description=report.stage, completed=report.step, total=report.steps or None, said=said
            )
            return
        now = time.monotonic()
        if report.stage != self._stage or now - self._said >= _EVERY_S:
            self._stage, self._said = report.stage, now
            of = f" {report.step} of {report.steps}" if report.steps else ""
            stderr().print(f"{now - self._began:6.0f} s  {report.stage}{of}: {said}", markup=False)


def describe_progress(report: Progress) -> str:
    """Intents and likelihood in words."""
    said = f"{report.intents} intent{'s' if report.intents != 1 else ''}"
    if math.isfinite(report.log_likelihood):
        said += f", {report.log_likelihood:.3f} nats per row{' held out' if report.held_out else ''}"
    return said


def _read(path: Path) -> list[Said]:
    """Reports of an earlier run; a line that a kill cut short ends them."""
    found: list[Said] = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            stage, step, intents, nats, held = json.loads(line)
        except ValueError:
            break
        found.append((stage, step, intents, nats, held))
    return found


def make_board(folder: Path) -> Any:
    """A TensorBoard writer where it is installed, else None."""
    if importlib.util.find_spec("tensorboard") is None or importlib.util.find_spec("torch") is None:
        return None
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(folder))
