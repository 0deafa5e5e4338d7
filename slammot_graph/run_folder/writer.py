"""The run folder: what a run leaves on the disk, and readers of what other programs want back.

Every file is written under a temporary name and then renamed: a file of a run folder is whole or not there.
"""

import json
import os
import platform
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GraphEdge, GridMap, RunResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.evaluation import run_consistency
from slammot_graph.evaluation.trajectories import path_length, read_trajectory
from slammot_graph.logs import LaserLog, source_of

__all__ = ["RUN_FILES", "PointLabels", "prepare_output", "read_points", "read_trajectory", "write_run_folder"]

RUN_FILES = (
    "trajectory.tum",
    "points.npz",
    "tracks.csv",
    "map.pgm",
    "map.yaml",
    "graph.g2o",
    "covariances.npz",
    "run.rrd",
    "overview.png",
    "summary.json",
)
"""All that a run folder may hold; without a graph there is no ``graph.g2o``, unrecorded no ``run.rrd``."""
FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values of ``map.pgm``, as map_server's own saver writes them."""
FREE_BELOW, OCCUPIED_ABOVE = 0.2, 0.8
"""Probabilities of occupation that make a cell free or occupied (the paper's)."""
FREE_THRESH = 0.196
"""Of ``map.yaml``: map_server reads grey 205 as 50 / 255 = 0.19608, so with 0.2 unknown cells became free."""
MAX_EVENTS = 200
"""So many events are named in ``summary.json``; the rest is counted."""
PACKAGES = (
    "gtsam",
    "numpy",
    "scipy",
    "numba",
    "kiss-icp",
    "rerun-sdk",
    "rosbags",
    "matplotlib",
)

_FIRST_FILES = ("run.rrd", "trajectory.tum")  # at least one of them is there when a run was cut short
_TRACK_COLUMNS = "stamp,id,x,y,vx,vy,var_x,cov_xy,var_y"


@dataclass(frozen=True, kw_only=True, eq=False)
class PointLabels:
    """The labels of all beams of a run, n scans of at most `beams` beams.

    Attributes
    ----------
    stamps : (n,) array [s]
    is_valid, is_moving, is_moving_online : (n, beams) bool arrays
        `is_moving` are the final labels, `is_moving_online` those decided at the time.
    p_moving : (n, beams) float16 array
        Probability that the beam hit something moving; NaN where not valid.
    """

    stamps: FloatArray
    is_valid: BoolArray
    is_moving: BoolArray
    is_moving_online: BoolArray
    p_moving: npt.NDArray[np.float16]


def prepare_output(output: str | Path, *, overwrite: bool) -> None:
    """Make an empty run folder, with the folders above it.

    Parameters
    ----------
    output : str or Path
    overwrite : bool
        Remove the files of a run that is already there; other files in the folder stay.

    Raises
    ------
    InputError
        `output` is a file, holds a run and `overwrite` is not set, holds something that is no run, or cannot be
        written.
    """
    output = Path(output)
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, not a folder; name another --output")
    with _os_errors(output, "name another --output"):
        output.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in output.iterdir())
    if names and not _is_run_folder(output, names):
        raise InputError(
            f"{output}: holds {names[0]!r} and is no run folder; name a new or an empty folder as --output"
        )
    if names and not overwrite:
        raise InputError(
            f"{output}: holds a run already; pass --overwrite to replace it, or name another --output"
        )
    with _os_errors(output, "remove it yourself, or name another --output"):
        for name in RUN_FILES:
            (output / name).unlink(missing_ok=True)
            _temporary(output / name).unlink(missing_ok=True)
    if not os.access(output, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


def write_run_folder(
    output: str | Path, result: RunResult, *, log: LaserLog | str | Path | None = None
) -> None:
    """Write all files of a run but the recording.

    A method without a pose graph leaves no ``graph.g2o``. ``covariances.npz`` holds `stamps` (n,) [s], `cov_map`
    (n, 3, 3) of the poses of ``trajectory.tum``, and `node_scans` (m,): the vertex k of ``graph.g2o`` is the scan
    ``node_scans[k]``, counted from 0, which is also its line in ``trajectory.tum``.

    Parameters
    ----------
    output : str or Path
        The run folder; made if it is not there, and files of an earlier run in it are replaced.
    result : RunResult
    log : LaserLog, str or Path, optional
        The log that was run; its absolute path goes into the summary, and of a `LaserLog` also its `source` (see
        `source_of`), its warnings and its number of scans.

    Raises
    ------
    InputError
        A file cannot be written; the text names it.
    """
    from slammot_graph.viz.overview import draw_overview

    output, log_path = Path(output), _path_of(log)
    with _os_errors(output, "name another --output"):
        output.mkdir(parents=True, exist_ok=True)
    _write_text(output / "trajectory.tum", _trajectory_lines(result.stamps, result.T_map_base))
    _write_arrays(
        output / "points.npz",
        stamps=result.stamps,
        is_valid=result.is_valid,
        is_moving=result.is_moving,
        is_moving_online=result.is_moving_online,
        p_moving=np.asarray(result.p_moving, dtype=np.float16),
    )
    _write_text(output / "tracks.csv", _track_lines(result.tracks))
    with _replacing(output / "map.pgm") as path:
        path.write_bytes(_pgm(result.grid))
    _write_text(output / "map.yaml", _map_lines(result.grid))
    if len(result.nodes):
        _write_text(output / "graph.g2o", _graph_lines(result.nodes, result.edges))
    else:
        with _os_errors(output / "graph.g2o", "remove it yourself, or name another --output"):
            (output / "graph.g2o").unlink(missing_ok=True)
    _write_arrays(
        output / "covariances.npz",
        stamps=result.stamps,
        cov_map=result.cov_map,
        node_scans=result.node_scans.astype(np.int64),
    )
    summary = json.dumps(_strict(_summary(result, log)), indent=2, allow_nan=False, ensure_ascii=False)
    _write_text(output / "summary.json", [summary])
    with _replacing(output / "overview.png") as path:
        draw_overview(
            result,
            path,
            log_name=log_path.name if log_path else None,
            moving_points=result.moving_points,
        )


def read_points(path: str | Path) -> PointLabels:
    """Read the labels of a run's beams, ``points.npz``.

    Raises
    ------
    InputError
        The file is missing or is not what a run writes; the text says what is wrong with it.
    """
    path = Path(path)
    names = ("stamps", "is_valid", "is_moving", "is_moving_online", "p_moving")
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            missing = [name for name in names if name not in file]
            if missing:
                raise InputError(f"{path}: has no array {missing[0]!r}; is it the points.npz of a run?")
            arrays = {name: np.asarray(file[name]) for name in names}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path") from None
    except (ValueError, EOFError, BadZipFile, zlib.error, TypeError, AttributeError):
        raise InputError(f"{path}: not a whole .npz file of plain arrays; was the run cut short?") from None
    shape = arrays["is_valid"].shape
    for name, array in arrays.items():
        expected = shape[:1] if name == "stamps" else shape
        kind = {"stamps": "f", "p_moving": "f"}.get(name, "b")
        if len(shape) != 2 or array.shape != expected or array.dtype.kind != kind:
            raise InputError(
                f"{path}: array {name!r} is {array.dtype} {array.shape}, which does not fit points of a run"
            )
    return PointLabels(
        stamps=arrays["stamps"].astype(np.float64),
        is_valid=arrays["is_valid"],
        is_moving=arrays["is_moving"],
        is_moving_online=arrays["is_moving_online"],
        p_moving=arrays["p_moving"].astype(np.float16),
    )


# ------------------------------------------------------------------------------------------------- contents


def _trajectory_lines(stamps: FloatArray, T_map_base: FloatArray) -> Iterator[str]:
    half = 0.5 * T_map_base[:, 2]
    columns = (stamps, T_map_base[:, 0], T_map_base[:, 1], np.sin(half), np.cos(half))
    for stamp, x, y, qz, qw in zip(*(column.tolist() for column in columns), strict=True):
        yield f"{stamp:.9f} {x:.9f} {y:.9f} 0 0 0 {qz:.9f} {qw:.9f}"


def _track_lines(tracks: FloatArray) -> Iterator[str]:
    yield _TRACK_COLUMNS
    for stamp, track_id, *numbers in tracks[:, :9].tolist():
        yield ",".join([f"{stamp:.9f}", str(int(track_id)), *(f"{number:.9g}" for number in numbers)])


def _pgm(grid: GridMap) -> bytes:
    """Three states of the cells as a binary PGM; its row 0 is the top, ours the lowest y."""
    with np.errstate(invalid="ignore"):
        is_free, is_occupied = grid.p_occupied < FREE_BELOW, grid.p_occupied > OCCUPIED_ABOVE
    grey = np.full(grid.p_occupied.shape, UNKNOWN, dtype=np.uint8)
    grey[is_free], grey[is_occupied] = FREE, OCCUPIED
    n_rows, n_cols = grid.p_occupied.shape
    return f"P5\n{n_cols} {n_rows}\n255\n".encode("ascii") + np.flipud(grey).tobytes()


def _map_lines(grid: GridMap) -> list[str]:
    x, y = grid.origin.tolist()
    return [
        "image: map.pgm",
        "mode: trinary",
        f"resolution: {float(grid.resolution_m)!r}",
        f"origin: [{x:.9f}, {y:.9f}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_ABOVE}",
        f"free_thresh: {FREE_THRESH}",
    ]


def _graph_lines(nodes: FloatArray, edges: tuple[GraphEdge, ...]) -> Iterator[str]:
    upper = np.triu_indices(3)
    for number, pose in enumerate(nodes.tolist()):
        yield f"VERTEX_SE2 {number} {_numbers(pose)}"
    for edge in edges:
        numbers = [*edge.T_from_to.tolist(), *edge.information[upper].tolist()]
        yield f"EDGE_SE2 {edge.from_node} {edge.to_node} {_numbers(numbers)}"


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _summary(result: RunResult, log: LaserLog | str | Path | None) -> dict[str, Any]:
    step_ms = result.stage_ms.get("step", np.zeros(0))
    n_valid = int(np.count_nonzero(result.is_valid))
    n_moving = int(np.count_nonzero(result.is_moving & result.is_valid))
    path, opened = _path_of(log), None if isinstance(log, str | Path) else log
    return {
        "method": result.method,
        "log": None if path is None else path.absolute(),
        "source": {} if opened is None else source_of(opened),
        "warnings": [] if opened is None else opened.warnings,
        "config": result.config,
        "versions": _versions(),
        "is_complete": result.is_complete,
        "n_scans": len(result.stamps),
        "n_scans_of_log": None if opened is None else opened.n_scans,
        "n_skipped": result.n_skipped,
        "n_failed_matches": result.n_failed_matches,
        "n_nodes": len(result.nodes),
        "n_loop_closures": sum(edge.kind == "closure" for edge in result.edges),
        "path_length_m": path_length(result.T_map_base),
        "duration_s": float(np.ptp(result.stamps)) if len(result.stamps) else 0.0,
        "n_tracks": len(np.unique(result.tracks[:, 1])),
        "moving_share": n_moving / n_valid if n_valid else None,
        "nis": _figures(result.nis, with_mean=True),
        "consistency": asdict(run_consistency(result)),
        "stages_ms": {stage: _figures(took) for stage, took in result.stage_ms.items()},
        "scans_per_s": 1e3 * len(step_ms) / float(step_ms.sum()) if step_ms.sum() > 0.0 else None,
        "peak_memory_mb": _peak_memory_mb(),
        "n_events": len(result.events),
        "events": [{**asdict(event), "text": event.text} for event in result.events[:MAX_EVENTS]],
    }


def _path_of(log: LaserLog | str | Path | None) -> Path | None:
    if log is None:
        return None
    return Path(log) if isinstance(log, str | Path) else log.path


def _figures(values: FloatArray, *, with_mean: bool = False) -> dict[str, float | None]:
    """Median and 95th percentile, over what is finite; None over nothing."""
    known = values[np.isfinite(values)]
    if not len(known):
        return dict.fromkeys(("median", "mean", "p95") if with_mean else ("median", "p95"))
    median, p95 = np.percentile(known, [50, 95]).tolist()
    return {"median": median, **({"mean": float(known.mean())} if with_mean else {}), "p95": p95}


def _versions() -> dict[str, str]:
    from slammot_graph import __version__

    versions = {"python": platform.python_version(), "slammot-graph": __version__}
    for package in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def _peak_memory_mb() -> float | None:
    """Peak resident memory of this process [MB of 2^20 bytes], None where the system does not tell."""
    with suppress(OSError, ValueError):
        # not getrusage: its peak survives exec, and is then that of the program that started this one
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    try:
        import resource
    except ImportError:
        return None
    unit = 2**20 if platform.system() == "Darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def _strict(value: Any) -> Any:
    """Turn what JSON does not know into what it does: undefined and infinite numbers become null."""
    if isinstance(value, Mapping):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_strict(item) for item in value]
    if isinstance(value, np.generic):
        return _strict(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


# ---------------------------------------------------------------------------------------------------- files


def _is_run_folder(output: Path, names: list[str]) -> bool:
    """Whether a run was written here, or cut short before its summary."""
    try:
        summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        ours = {*RUN_FILES, *(_temporary(output / name).name for name in RUN_FILES)}
        return ours.issuperset(names) and any(name in names for name in _FIRST_FILES)
    return isinstance(summary, dict) and {"method", "n_scans"} <= summary.keys()


def _write_text(path: Path, lines: Iterator[str] | list[str]) -> None:
    with _replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def _write_arrays(path: Path, **arrays: npt.NDArray[Any]) -> None:
    with _replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.tmp")


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path that becomes `path` when all went well, and goes away when not."""
    temporary = _temporary(path)
    with _os_errors(path, "free some space or name another --output"):
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def _os_errors(path: Path, remedy: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); {remedy}") from error
