"""`jink report`: rows of one or several files to one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from jink.training.console import check_separate, check_writable
from jink.training.rows import read_rows

__all__ = ["report"]


def report(files: Sequence[Path], out: Path, title: str = "Jink benchmark") -> int:
    """Make the page.

    Args:
        files: Parquet rows of `jink bench`.
        out: .html file.
        title: heading of the page.

    Returns:
        how many rows it was made from.

    Raises:
        ValueError: a file that does not exist or holds something else, no rows, or an output that is refused.
        OSError: the page cannot be written.
    """
    from jink.training.report.page import write_report

    check_writable(out, "--out", (".html", ".htm"))
    parts = []
    for file in files:
        if file.is_dir():
            raise ValueError(
                f"report: ROWS must be Parquet files; got the folder {file}. Name its files: {file / '*.parquet'}."
            )
        if not file.is_file():
            raise ValueError(f"report: file must exist; got {file}. Make it with jink bench --out {file.name}.")
        check_separate(out, "--out", {"the file of rows": file})
        try:
            parts.append(read_rows(file))
        except ValueError as error:
            said = str(error).removeprefix("--out: ").replace("hoose another --out.", "hoose another file.")
            raise ValueError(f"report: {said}") from error
    rows = pd.concat(parts, ignore_index=True)
    write_report(rows, out, title, " ".join(file.name for file in files))
    return len(rows)
