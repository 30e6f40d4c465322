"""What the commands say and when: results, progress after two seconds, the compile notice, one-sentence errors."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = [
    "check_separate",
    "check_writable",
    "name_what_compiles",
    "progress",
    "run_command",
    "say_when_compiling",
    "screen",
    "stderr",
]

PATIENCE_S = 2.0
"""A progress bar appears after this long."""
STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""


def screen() -> Console:
    """Where results go; as wide as the terminal, 110 columns where there is none."""
    return Console(file=sys.stdout, width=None if sys.stdout.isatty() else 110, highlight=False)


def stderr() -> Console:
    """Where progress, notices and errors go."""
    return Console(file=sys.stderr, stderr=True, highlight=False, soft_wrap=True)


@contextlib.contextmanager
def progress(text: str, total: float | None = None) -> Iterator[Callable[..., None]]:
    """A progress bar on stderr that appears after two seconds and leaves nothing behind; none in a log file.

    Args:
        text: what is going on.
        total: how often the yielded function will be called, or None if unknown.

    Yields:
        ``advance(steps=1, text=None)``: counts work done; `text` renames the bar.
    """
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=stderr(),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    task = bar.add_task(text, total=total)
    began = time.monotonic()

    def advance(steps: float = 1, text: str | None = None) -> None:
        bar.update(task, advance=steps, description=text)
        if not bar.live.is_started and time.monotonic() - began > PATIENCE_S:
            bar.start()

    try:
        yield advance
    finally:
        bar.stop()


@contextlib.contextmanager
def say_when_compiling() -> Iterator[None]:
    """Say "compiling (first run only)" on stderr, once, as soon as Numba compiles something not in its cache."""
    from numba.core import event

    class Listener(event.Listener):
        said = False

        def on_start(self, event: Any) -> None:
            if not self.said:
                self.said = True
                stderr().print("compiling (first run only)")

        def on_end(self, event: Any) -> None:
            """Nothing to do: the notice stays."""

    # A kernel found on disk runs no compiler pass, so this event means real work, callbacks included.
    with event.install_listener("numba:run_pass", Listener()):
        yield


@contextlib.contextmanager
def name_what_compiles(tell: Callable[[str], None]) -> Iterator[None]:
    """Call `tell` with the name of each function that Numba compiles because its cache does not have it.

    Args:
        tell: gets the bare name; called again only when it changes.
    """
    from numba.core import event

    class Listener(event.Listener):
        name = ""

        def on_start(self, event: Any) -> None:
            what = event.data or {}
            name = str(what.get("qualname", "")).rpartition(".")[2]
            if name and name != self.name and not str(what.get("module", "")).startswith("numba."):
                self.name = name
                tell(name)

        def on_end(self, event: Any) -> None:
            """Nothing to do: the next name replaces it."""

    with event.install_listener("numba:run_pass", Listener()):
        yield


def check_writable(path: Path | None, option: str, suffixes: tuple[str, ...]) -> None:
    """Refuse an output file that could not be written, before anything is computed.

    Args:
        path: the file; None passes.
        option: the command-line option that named it.
        suffixes: allowed endings, the first is the remedy.

    Raises:
        ValueError: another ending, a folder that does not exist or cannot be written to, or a folder itself.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise ValueError(
            f"{option}: file must end in {' or '.join(suffixes)}; got {path.name}. "
            f"Use for example {path.stem or 'file'}{suffixes[0]}."
        )
    if path.is_dir() or not path.parent.is_dir():
        raise ValueError(f"{option}: file must lie in an existing folder; got {path}. Make {path.parent} first.")
    probe = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ValueError(
            f"{option}: folder must be writable; got {path.parent} ({error.strerror}). Choose another folder."
        ) from error


def check_separate(path: Path | None, option: str, inputs: Mapping[str, Path | None]) -> None:
    """Refuse an output file that is one of the inputs, under whatever name or link.

    Args:
        path: the file; None passes.
        option: the command-line option that named it.
        inputs: what each input is called, and where it is; None passes.

    Raises:
        ValueError: it is an input.
    """
    for name, file in inputs.items():
        if path is not None and file is not None and path.exists() and file.exists() and path.samefile(file):
            raise ValueError(
                f"{option}: file must not be {name}, which would be lost; got {path}. Choose another name."
            )


def run_command(call: Callable[[], Any]) -> int:
    """Run a command and turn what goes wrong for the user into one sentence on stderr.

    Args:
        call: the command.

    Returns:
        exit code: 0, 2 for refused input, 130 after Ctrl-C, or what the command asked for.
    """
    try:
        result = call()
        code = result if isinstance(result, int) else 0
    except KeyboardInterrupt:
        code = STOPPED
    except BrokenPipeError:
        # The reader of a pipe (head, less) has seen enough.
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115
        return 0
    except (ValueError, OSError) as error:
        stderr().print(f"jink: {_sentence(error)}", markup=False)
        return 2
    except Exception as error:
        found = _usage_code(error)
        if found is None:
            raise
        code = found
    if code == STOPPED:
        stderr().print("jink: stopped; files written so far are complete.")
    return code


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        name = f"{error.filename}: " if error.filename else ""
        return f"{name}{error.strerror.lower()}."
    return " ".join(str(error).split())


def _usage_code(error: Exception) -> int | None:
    """Exit code of a command-line mistake (typer's own exceptions, wherever they live), None for others."""
    name = type(error).__name__
    if name == "Abort":
        return STOPPED
    if name == "Exit":
        return int(getattr(error, "exit_code", 0))
    message = getattr(error, "format_message", None)
    if message is None:
        return None
    text = " ".join(str(message()).split())
    if text:
        stderr().print(f"jink: {text.rstrip('.')}. Try --help.", markup=False)
    return 2
