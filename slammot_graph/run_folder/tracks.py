"""``tracks.csv``: a line for each moving object at each scan."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import MOST_TEXT_BYTES, check_regular
from slammot_graph.core.number_rows import MOST_SENSIBLE
from slammot_graph.core.results import TRACK_COLUMNS
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import write_text

COLUMNS = TRACK_COLUMNS[:-1]
REQUIRED_COLUMNS = COLUMNS[:4]
"""What another program's file must have."""


def write_tracks(path: Path, tracks: FloatArray) -> None:
    """Write tracks, the columns `TRACK_COLUMNS` of which the last one is left out.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_text(path, _lines(tracks))


def read_tracks(path: Path) -> FloatArray:
    """Read tracks (k, 9), NaN in columns that the file does not have; k = 0 where there is no file.

    Raises
    ------
    InputError
        A line has something else than numbers in its columns, or a required column is missing.
    """
    if not path.exists():
        return np.zeros((0, len(COLUMNS)))
    check_regular(path, MOST_TEXT_BYTES)
    rows: list[list[float]] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if reader.fieldnames and not set(REQUIRED_COLUMNS) <= set(reader.fieldnames):
                raise KeyError  # a file without a heading
            known = {*REQUIRED_COLUMNS, *(reader.fieldnames or ())}
            rows.extend([float(row[x]) if x in known else math.nan for x in COLUMNS] for row in reader)
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        place = f"{path}, line {len(rows) + 2}"
        raise InputError(f"{place}: expected numbers in the columns {', '.join(REQUIRED_COLUMNS)}") from None
    tracks = np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS))
    with np.errstate(invalid="ignore"):
        is_wrong = ~(np.abs(tracks[:, :4]) < MOST_SENSIBLE).all(axis=1) | (tracks[:, [6, 8]] < 0.0).any(
            axis=1
        )
    if is_wrong.any():
        place = f"{path}, line {int(np.argmax(is_wrong)) + 2}"
        raise InputError(f"{place}: a place out of any sense or a negative variance; run it again")
    return tracks


def _lines(tracks: FloatArray) -> Iterator[str]:
    yield ",".join(COLUMNS)
    for stamp, track_id, *numbers in tracks[:, : len(COLUMNS)].tolist():
        yield ",".join([f"{stamp:.9f}", str(int(track_id)), *(f"{number:.9g}" for number in numbers)])
