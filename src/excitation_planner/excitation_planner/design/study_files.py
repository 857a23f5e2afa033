"""CSV files of a study, which grow by whole lines."""

import csv
import io
import os
from collections.abc import Iterable
from pathlib import Path

from tricycle_core.documents import read_bounded
from tricycle_core.errors import DesignError

MAX_BYTES = 256_000_000
"""Largest file that is read; a result takes about 30 bytes."""


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as the text of a CSV file.

    Parameters
    ----------
    rows : iterable
        Rows, each an iterable of cells.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_study_file(path: Path) -> bytes:
    """Return the content of a file of a study.

    Parameters
    ----------
    path : Path
        File of a study, or of outputs for one.
    """
    return read_bounded(path, MAX_BYTES, "a file of a study", DesignError)


class GrowingTable:
    """CSV file that grows by whole lines, and what of it has been read.

    Parameters
    ----------
    path : Path
        File; may be missing.
    header : list of str
        Cells of the first line.
    """

    def __init__(self, path: Path, header: list[str]) -> None:
        self._path, self._header, self._read = path, header, 0

    def new(self) -> list[list[str]]:
        """Return the rows added since the last call, without a last line that is not whole."""
        if not self._path.exists():
            return []
        with self._path.open("rb") as file:
            file.seek(self._read)
            whole = file.read(MAX_BYTES + 1)
        if len(whole) > MAX_BYTES:
            raise DesignError(f"{self._path}: larger than {MAX_BYTES} bytes")
        kept = whole[: whole.rfind(b"\n") + 1]
        rows = list(csv.reader(io.StringIO(kept.decode())))
        first, self._read = self._read == 0, self._read + len(kept)
        return rows[1:] if first else rows

    def begin_again(self) -> None:
        """Have `new` return all rows again."""
        self._read = 0

    def append(self, rows: list[list[object]]) -> None:
        """Add rows to what has been read, and wait until they are on disk.

        Parameters
        ----------
        rows : list of list
            Cells of each row.
        """
        if not rows:
            return
        text = csv_text(rows if self._read else [self._header, *rows]).encode()
        with self._path.open("ab") as file:
            file.truncate(self._read)  # a line cut off by a crash
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        self._read += len(text)
