"""Refusals of the library in the words of the command line: options and files, no internal names."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Collection, Iterator

__all__ = ["counted", "in_own_words"]

_CALLER = re.compile(r"(?P<caller>[A-Za-z_]\w*(?:\.[a-z_]\w*)?): (?P<rest>(?P<word>\S+).*)", re.DOTALL)


@contextlib.contextmanager
def in_own_words(subject: str, options: Collection[str] = (), files: Collection[str] = ()) -> Iterator[None]:
    """Replace the caller at the start of an error sentence by what the user typed.

    Args:
        subject: option or file that the sentence is about, where its first word does not say.
        options: arguments that are options of the command under the same name (``rate_hz``: ``--rate-hz``).
        files: names of files; a sentence that goes on with one of them needs no other subject.

    Raises:
        ValueError: in the words of the command line.
        FileNotFoundError: likewise.
    """
    try:
        yield
    except (ValueError, FileNotFoundError) as error:
        found = _CALLER.fullmatch(str(error))
        if found is None or found["caller"] in {subject, *files}:
            raise
        word, rest = found["word"], found["rest"]
        if word in options:
            rest = f"--{word.replace('_', '-')}: value{rest.removeprefix(word)}"
        elif word != "path" and word.rstrip(",") not in files:
            rest = f"{subject}: {rest}"
        raise type(error)(rest) from error


def counted(count: object, thing: str) -> str:
    """A number of things: "1 track", "7 tracks"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
