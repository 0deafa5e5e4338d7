"""``tracks.csv`` and ``tracks_online.csv``: a line for each moving object at each scan.

The columns of both: `stamp` [s], `id`, `x`, `y` [m], `vx`, `vy` [m/s] and the covariance `var_x`, `cov_xy`, `var_y`
[m^2] of (x, y), map frame; `is_seen` (1: it was seen in that scan, 0: only predicted or interpolated). ``tracks.csv``
holds the final tracks, linked and smoothed after the run, and also `class` (person, vehicle, unknown), its
`probability` and `size` [m], the same in all lines of an id; empty where nothing is known. ``tracks_online.csv`` holds
what was reported when each scan came, with identities of its own, and `base_x`, `base_y` [m], `base_yaw` [rad], where
the robot was believed to be at that time: the map may have moved since.
"""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import MOST_TEXT_BYTES, check_regular
from slammot_graph.core.number_rows import MOST_SENSIBLE
from slammot_graph.core.results import TRACK_COLUMNS, RunResult
from slammot_graph.core.stamps import STAMP_TOLERANCE_S, nearest_stamps
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import write_text

COLUMNS = TRACK_COLUMNS[:-1]
OBJECT_COLUMNS = ("is_seen", "class", "probability", "size")
ONLINE_COLUMNS = ("is_seen", "base_x", "base_y", "base_yaw")
REQUIRED_COLUMNS = COLUMNS[:4]
"""What another program's file must have."""


def write_tracks(path: Path, result: RunResult) -> None:
    """Write the final tracks of a run.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    known = {one.track_id: one for one in result.objects}
    ends: list[tuple[str, ...]] = []
    for number, is_seen in zip(
        result.tracks[:, 1].astype(np.int64).tolist(), result.is_track_seen, strict=True
    ):
        one = known.get(number)
        told = (
            ("unknown", "", "") if one is None else (one.kind, _number(one.probability), _number(one.size_m))
        )
        ends.append((str(int(is_seen)), *told))
    write_text(path, _lines(result.tracks, OBJECT_COLUMNS, ends))


def write_tracks_online(path: Path, result: RunResult) -> None:
    """Write the tracks as reported when each scan came.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    rows = nearest_stamps(result.stamps, result.tracks_online[:, 0], STAMP_TOLERANCE_S)
    ends: list[tuple[str, ...]] = [
        (str(int(is_seen)), *map(_number, result.T_map_base_online[row].tolist()))
        for row, is_seen in zip(rows.tolist(), result.is_track_online_seen.tolist(), strict=True)
    ]
    write_text(path, _lines(result.tracks_online, ONLINE_COLUMNS, ends))


def read_tracks(path: Path) -> FloatArray:
    """Read tracks (k, 9), NaN in columns that the file does not have; k = 0 where there is no file.

    Raises
    ------
    InputError
        A line has something else than numbers in its columns, or a required column is missing.
    """
    return read_track_columns(path, COLUMNS)


def read_track_columns(path: Path, columns: tuple[str, ...]) -> FloatArray:
    """Read columns of numbers (k, len(columns)); otherwise as `read_tracks`."""
    if not path.exists():
        return np.zeros((0, len(columns)))
    check_regular(path, MOST_TEXT_BYTES)
    rows: list[list[float]] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if reader.fieldnames and not set(REQUIRED_COLUMNS) <= set(reader.fieldnames):
                raise KeyError  # a file without a heading
            known = {*REQUIRED_COLUMNS, *(reader.fieldnames or ())}
            rows.extend([float(row[x]) if x in known else math.nan for x in columns] for row in reader)
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        place = f"{path}, line {len(rows) + 2}"
        raise InputError(f"{place}: expected numbers in the columns {', '.join(REQUIRED_COLUMNS)}") from None
    tracks = np.array(rows, dtype=np.float64).reshape(-1, len(columns))
    is_place = [name in REQUIRED_COLUMNS for name in columns]
    is_variance = [name.startswith("var_") for name in columns]
    with np.errstate(invalid="ignore"):
        is_sensible = (np.abs(tracks[:, is_place]) < MOST_SENSIBLE).all(axis=1)
        is_sensible &= ~(tracks[:, is_variance] < 0.0).any(axis=1)
    if not is_sensible.all():
        place = f"{path}, line {int(np.argmin(is_sensible)) + 2}"
        raise InputError(f"{place}: a place out of any sense or a negative variance; run it again")
    return tracks


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.9g}"


def _lines(tracks: FloatArray, more: tuple[str, ...], ends: list[tuple[str, ...]]) -> Iterator[str]:
    yield ",".join((*COLUMNS, *more))
    for (stamp, track_id, *numbers), end in zip(tracks[:, : len(COLUMNS)].tolist(), ends, strict=True):
        yield ",".join([f"{stamp:.9f}", str(int(track_id)), *(f"{number:.9g}" for number in numbers), *end])
