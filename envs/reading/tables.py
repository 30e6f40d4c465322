"""Raw CSV and Parquet tables: named columns, exact row numbers, one sentence per refusal.

Nothing here knows about tracks. CSV text is UTF-8 (a byte-order mark is skipped), the separator is a comma,
semicolon or tab, the header is the first line (a leading `#` is dropped, with any remark in brackets after
it). Every row must have as many cells as the header: a file cut off in the middle of a row is refused, not
half-read.
Row numbers count data rows from 1, blank lines left out; `line` is the line an editor shows.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

CALLER = "read_tracks"


@dataclass(frozen=True)
class Table:
    """One opened file: its name, its columns' names and, for CSV, the text after the header."""

    path: Path
    names: tuple[str, ...]
    body: bytes | None
    separator: str
    header_lines: int

    @property
    def columns_text(self) -> str:
        """The column names as a sentence part, shortened when there are very many."""
        shown = ", ".join(self.names[:30])
        return shown + (f", ... ({len(self.names)} in all)" if len(self.names) > 30 else "")

    def refuse(self, rule: str, got: object, remedy: str) -> NoReturn:
        """Raise the sentence that refuses the whole file."""
        raise ValueError(f"{CALLER}: {self.path.name} must {rule}; got {_one_line(got)}. {remedy}")

    def refuse_cell(self, row: int, column: str, rule: str, got: object, remedy: str) -> NoReturn:
        """Raise the sentence that refuses one cell; `row` counts data rows from 0."""
        line = "" if self.body is None else f" (line {_line_of_row(self, row)})"
        raise ValueError(
            f"{CALLER}: {self.path.name}, row {row + 1}{line}, column '{column}' must {rule}; "
            f"got {_one_line(got)}. {remedy}"
        )


def _one_line(got: object) -> str:
    """What was found, fit for a sentence: line breaks out, and no longer than a column list."""
    return " ".join(str(got).split())[:1000]


def open_table(path: str | Path) -> Table:
    """Open a CSV or Parquet file and read its column names.

    Args:
        path: file; Parquet is known by its first bytes, anything else is read as CSV text.

    Returns:
        the opened table, no column read yet.

    Raises:
        FileNotFoundError: no such file.
        IsADirectoryError: a folder.
        ValueError: empty, no text, no header, a repeated column name, or damaged Parquet.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{CALLER}: path must name a file; got the folder {path}. Name one file inside it.")
    if not path.exists():
        raise FileNotFoundError(f"{CALLER}: path must name an existing file; got {path}. Check the spelling.")
    content = path.read_bytes()
    if content[:4] == b"PAR1":
        try:
            names = tuple(str(name) for name in pq.read_schema(path).names)
        except (pa.ArrowException, OSError) as error:
            why = str(error).splitlines()[0].rstrip(".")
            raise ValueError(
                f"{CALLER}: {path.name} must be a whole Parquet file; got damage ({why}). Write it again."
            ) from error
        table = Table(path, names, None, ",", 0)
    else:
        table = _open_text(path, content.removeprefix(b"\xef\xbb\xbf"))
    repeated = sorted({name for name in table.names if table.names.count(name) > 1})
    if repeated:
        table.refuse("name each column once", f"{', '.join(repeated)} more than once", "Rename one of them.")
    return table


def _open_text(path: Path, content: bytes) -> Table:
    """Find the header and the separator of CSV text."""
    table = Table(path, (), content, ",", 0)
    if not content or content.isspace():
        table.refuse("have a header and data rows", "an empty file", "Write it again.")
    if b"\0" in content[:65536]:
        table.refuse("be CSV text (UTF-8) or Parquet", "binary data", "Export it as CSV.")
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        table.refuse("be CSV text (UTF-8) or Parquet", "bytes that are not UTF-8", "Save it as UTF-8.")
    offset, lines, header, remark = 0, 0, "", ""
    while offset < len(content) and not header:
        end = content.find(b"\n", offset) + 1 or len(content)
        text = content[offset:end].decode("utf-8").strip()
        if text and not text.startswith("#"):
            if remark and _is_data(text):
                break
            header = text
        remark = text or remark
        offset, lines = end, lines + 1
    header = header or re.sub(r"\s*\(.*$", "", remark.lstrip("# \t"))
    separator = max(",;\t", key=header.count)
    names = tuple(name.strip() for name in next(csv.reader([header], delimiter=separator)))
    if all(is_number(name) for name in names):
        table.refuse("have a header line", f"numbers in its first line ({header[:60]})", "Add the columns' names.")
    if names.count("") > 1:
        names = tuple(name or f"column {index + 1}" for index, name in enumerate(names))
    return Table(path, names, content[offset:], separator, lines)


def load(table: Table, columns: list[str]) -> dict[str, pa.ChunkedArray]:
    """Read the named columns of an opened table, CSV as text and Parquet in its own types.

    Raises:
        ValueError: no data row, a row with too few or too many cells, or text that is not UTF-8.
    """
    if table.body is None:
        try:
            data = pq.read_table(table.path, columns=columns)
        except (pa.ArrowException, OSError) as error:
            table.refuse("be a whole Parquet file", f"damage ({str(error).splitlines()[0]})", "Write it again.")
    else:
        if not table.body or table.body.isspace():
            table.refuse("have data rows", "a header only", "Check the export.")
        data = _parse_text(table, columns, threads=True)
    if data.num_rows == 0:
        table.refuse("have data rows", "a header only", "Check the export.")
    return {name: data.column(name) for name in columns}


def _parse_text(table: Table, columns: list[str], *, threads: bool) -> pa.Table:
    """Parse CSV text; a row of the wrong width is found by parsing again in order."""
    wrong: list[Any] = []

    def note(row: Any) -> str:
        wrong.append(row)
        return "error"

    try:
        return pacsv.read_csv(
            pa.BufferReader(table.body),
            read_options=pacsv.ReadOptions(column_names=list(table.names), use_threads=threads),
            parse_options=pacsv.ParseOptions(delimiter=table.separator, invalid_row_handler=note),
            convert_options=pacsv.ConvertOptions(
                include_columns=columns,
                column_types=dict.fromkeys(columns, pa.string()),
                strings_can_be_null=True,
                null_values=[""],
            ),
        )
    except pa.ArrowInvalid as error:
        if wrong and threads:
            return _parse_text(table, columns, threads=False)
        if wrong:
            row = wrong[0]
            table.refuse_cell(
                row.number - 1,
                table.names[min(row.actual_columns, len(table.names)) - 1],
                f"be followed by the cells of all {row.expected_columns} columns and no more",
                f"a row of {row.actual_columns} cells",
                "Correct or remove the row.",
            )
        why = str(error).splitlines()[0][:120].rstrip(".")
        table.refuse("be CSV text (UTF-8) or Parquet", f"text that cannot be parsed ({why})", "Save it as UTF-8 CSV.")


def _line_of_row(table: Table, row: int) -> int:
    """The line of a data row as an editor counts it: blank lines are lines but not rows."""
    seen = -1
    for index, line in enumerate((table.body or b"").split(b"\n")):
        seen += bool(line.strip(b"\r"))
        if seen == row:
            return table.header_lines + index + 1
    return table.header_lines + row + 1


def is_number(text: str) -> bool:
    """Whether a text is one number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_data(text: str) -> bool:
    """Whether a line starts with a number, so that the commented line before it is the header."""
    return is_number(re.split(r"[,;\t]", text)[0].strip())
