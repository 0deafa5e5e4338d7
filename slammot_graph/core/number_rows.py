"""Text files of numbers: a fixed count of columns, a row a line."""

from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import MOST_TEXT_BYTES, check_regular
from slammot_graph.core.types import FloatArray

MOST_SENSIBLE = 1e13
"""No time in seconds and no place in metres is farther from zero."""


def read_number_rows(path: Path, n_columns: int) -> FloatArray:
    """Read a text file of `n_columns` finite numbers a line as an (n, n_columns) array.

    Empty lines and what follows ``#`` are skipped.

    Raises
    ------
    InputError
        The file cannot be read, or a line in it is malformed; the text names the line.
    """
    check_regular(path, MOST_TEXT_BYTES)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file of {n_columns} numbers a line") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != n_columns or not all(abs(value) < MOST_SENSIBLE for value in row):
            raise InputError(
                f"{path}, line {number}: expected {n_columns} finite numbers (below {MOST_SENSIBLE:g}), not"
                f" {line[:60]!r}"
            )
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, n_columns)
