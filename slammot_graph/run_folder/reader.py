"""A run folder read back, of this package or of another program that keeps to the contract."""

import csv
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.logs import LaserLog
from slammot_graph.run_folder.writer import PointLabels, read_points, read_trajectory

STAMP_TOLERANCE_S = 1e-5
"""Stamps are written with six decimals or more; scans lie much farther apart than this."""
TRACK_COLUMNS = ("stamp", "id", "x", "y")


@dataclass(frozen=True, kw_only=True, eq=False)
class RunFolder:
    """What a run folder holds, n scans in the log's order; only the trajectory must be there.

    Attributes
    ----------
    path : Path
    method : str
        As the summary says; without one, the folder's name.
    stamps : (n,) array [s]
    T_map_base : (n, 3) array
        The trajectory [m, m, rad].
    points : PointLabels or None
        Of the same n scans.
    tracks : (k, 4) array
        Columns stamp [s], id, x, y [m] in the map frame; k = 0 without tracks.
    grid : GridMap
        Of three states: 0 free, 1 occupied, NaN unknown; without cells where there is no map.
    cov_map : (n, 3, 3) array or None
        Covariance of `T_map_base`, right perturbation (body frame), order (x, y, theta).
    summary : mapping
        ``summary.json``; empty without one.
    """

    path: Path
    method: str
    stamps: FloatArray
    T_map_base: FloatArray
    points: PointLabels | None
    tracks: FloatArray
    grid: GridMap
    cov_map: FloatArray | None
    summary: Mapping[str, Any]

    @property
    def log(self) -> Path | None:
        """The log that was run, where the summary names it."""
        name = self.summary.get("log")
        return Path(name) if isinstance(name, str) else None

    def figure(self, *keys: str) -> float:
        """Give a number of the summary, found by its keys from the outside in; NaN if it is not there."""
        value: Any = self.summary
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(value) if is_number else math.nan


def read_run_folder(path: str | Path) -> RunFolder:
    """Read a run folder.

    Raises
    ------
    InputError
        There is no such folder or no trajectory in it, a file in it is damaged, or its files are of different
        runs; the text names the file.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such run folder; name one that `slammot-graph run` wrote")
    trajectory = path / "trajectory.tum"
    stamps, T_map_base = read_trajectory(trajectory)
    if not len(stamps):
        raise InputError(f"{trajectory}: holds no poses; run it again")
    points = read_points(path / "points.npz") if (path / "points.npz").exists() else None
    if points is not None:
        _check_times(path / "points.npz", points.stamps, stamps)
    summary = _read_summary(path / "summary.json")
    return RunFolder(
        path=path,
        method=str(summary.get("method") or path.resolve().name),
        stamps=stamps,
        T_map_base=T_map_base,
        points=points,
        tracks=_read_tracks(path / "tracks.csv"),
        grid=_read_map(path / "map.yaml"),
        cov_map=_read_covariances(path / "covariances.npz", stamps),
        summary=summary,
    )


def have_same_times(a: FloatArray, b: FloatArray) -> bool:
    """Whether two runs (n,), (m,) [s] are of one log: their stamps agree as far as the shorter one goes.

    Not so if one of them is empty.
    """
    n = min(len(a), len(b))
    return n > 0 and np.allclose(a[:n], b[:n], rtol=0.0, atol=STAMP_TOLERANCE_S)


def scans_of(folder: RunFolder, log: LaserLog) -> Iterator[Scan]:
    """Iterate over the scans of a run: those of its log, as far as the run went.

    Raises
    ------
    InputError
        The log has other times, or fewer scans than the run.
    """
    n_scans = 0
    for scan in log:
        if n_scans == len(folder.stamps):
            return
        if not have_same_times(folder.stamps[n_scans : n_scans + 1], np.array([scan.stamp])):
            raise InputError(
                f"{log.path}: its scans have other times than those of {folder.path}; {_NAME_IT}"
            )
        n_scans += 1
        yield scan
    if n_scans < len(folder.stamps):
        raise InputError(
            f"{log.path}: has {n_scans} usable scans, {folder.path} has {len(folder.stamps)}; {_NAME_IT}"
        )


_NAME_IT = "name the log of that run"


def end_points(folder: RunFolder, row: int, scan: Scan) -> tuple[FloatArray, BoolArray]:
    """Give the valid points of a scan at the run's pose, and which of them move by the run's final labels.

    Parameters
    ----------
    folder : RunFolder
        Without labels, all points that the laser calls valid stand still.
    row : int
        Of the scan in the run.
    scan : Scan

    Returns
    -------
    points : (k, 2) array [m], map frame
    is_moving : (k,) bool array

    Raises
    ------
    InputError
        The labels do not fit the scan's beams.
    """
    if folder.points is None:
        is_valid, is_moving = scan.is_valid(), np.zeros(scan.laser.n_beams, dtype=np.bool_)
    else:
        n_beams = scan.laser.n_beams
        is_valid, is_moving = folder.points.is_valid[row, :n_beams], folder.points.is_moving[row, :n_beams]
        if len(is_valid) < n_beams:
            raise InputError(
                f"{folder.path / 'points.npz'}: has labels for {len(is_valid)} beams, the log has {n_beams};"
                f" {_NAME_IT}"
            )
    points = scan.points(folder.T_map_base[row])
    is_shown = is_valid & np.isfinite(points).all(axis=1)
    return points[is_shown], is_moving[is_shown]


# ------------------------------------------------------------------------------------------------------- files


def _check_times(path: Path, stamps: FloatArray, of_run: FloatArray) -> None:
    if len(stamps) != len(of_run) or not have_same_times(stamps, of_run):
        raise InputError(
            f"{path}: its scans are not those of trajectory.tum beside it; were files of two runs mixed?"
        )


def _read_summary(path: Path) -> Mapping[str, Any]:
    if not path.exists():
        return {}
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        summary = None
    if not isinstance(summary, dict):
        raise InputError(f"{path}: not the JSON of a run's summary; remove it or run again")
    return summary


def _read_tracks(path: Path) -> FloatArray:
    if not path.exists():
        return np.zeros((0, len(TRACK_COLUMNS)))
    rows: list[list[float]] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows.extend([float(row[name]) for name in TRACK_COLUMNS] for row in csv.DictReader(file))
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        place = f"{path}, line {len(rows) + 2}"
        raise InputError(f"{place}: expected numbers in the columns {', '.join(TRACK_COLUMNS)}") from None
    return np.array(rows, dtype=np.float64).reshape(-1, len(TRACK_COLUMNS))


def _read_covariances(path: Path, stamps: FloatArray) -> FloatArray | None:
    if not path.exists():
        return None
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            own_stamps, cov_map = np.asarray(file["stamps"], float), np.asarray(file["cov_map"], float)
    except (OSError, ValueError, KeyError, TypeError, EOFError, AttributeError, BadZipFile):
        raise InputError(f"{path}: not an .npz file of `stamps` and `cov_map`; run it again") from None
    _check_times(path, own_stamps, stamps)
    if cov_map.shape != (len(stamps), 3, 3):
        raise InputError(f"{path}: `cov_map` has shape {cov_map.shape}, not {(len(stamps), 3, 3)}")
    return cov_map


def _read_map(path: Path) -> GridMap:
    """Read a map in the format of ROS map_server; without a ``map.yaml`` a map without cells."""
    if not path.exists():
        return GridMap(p_occupied=np.zeros((0, 0)), resolution_m=0.05, origin=np.zeros(2))
    try:
        keys = dict(_yaml_lines(path.read_text(encoding="utf-8").splitlines()))
        resolution_m = float(keys["resolution"])
        x, y, yaw = (float(word) for word in keys["origin"].strip("[]").split(","))
        negate = int(keys.get("negate", "0"))
        free_below, occupied_above = (float(keys.get(name, default)) for name, default in _THRESHOLDS.items())
        image = path.parent / keys["image"]
    except (OSError, ValueError, KeyError):
        raise InputError(f"{path}: not a map of ROS map_server (image, resolution, origin)") from None
    if yaw != 0.0 or not 0.0 < resolution_m < math.inf:
        raise InputError(f"{path}: a map that is turned or has no size cannot be shown; remove it")
    grey = np.flipud(_read_image(image)).astype(
        np.float64
    )  # row 0 of the image is the top, ours the lowest y
    shade = (grey if negate else 255.0 - grey) / 255.0
    p_occupied = np.where(shade > occupied_above, 1.0, np.where(shade < free_below, 0.0, np.nan))
    return GridMap(p_occupied=p_occupied, resolution_m=resolution_m, origin=np.array([x, y]))


_THRESHOLDS = {"free_thresh": "0.196", "occupied_thresh": "0.65"}


def _yaml_lines(lines: Iterable[str]) -> Iterator[tuple[str, str]]:
    for line in lines:
        key, separator, value = line.partition(":")
        if separator and not line.lstrip().startswith("#"):
            yield key.strip(), value.split(" #", 1)[0].strip().strip("\"'")


def _read_image(path: Path) -> Any:
    from PIL import Image

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("L"))
    except (OSError, ValueError, SyntaxError):
        raise InputError(f"{path}: not a picture that can be read; run it again") from None
