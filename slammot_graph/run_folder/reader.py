"""Read a run folder, of this package or of another program that keeps to the contract."""

from pathlib import Path

from slammot_graph.core.errors import InputError
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.core.stamps import have_same_times
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.covariances import read_covariances
from slammot_graph.run_folder.map_files import read_map
from slammot_graph.run_folder.points import read_points
from slammot_graph.run_folder.summary import read_summary
from slammot_graph.run_folder.tracks import read_tracks
from slammot_graph.run_folder.tum import read_trajectory


def read_run_folder(path: str | Path) -> RunFolder:
    """Read a run folder; only ``trajectory.tum`` must be there.

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
    summary = read_summary(path / "summary.json")
    return RunFolder(
        path=path,
        method=str(summary.get("method") or path.resolve().name),
        stamps=stamps,
        T_map_base=T_map_base,
        points=points,
        tracks=read_tracks(path / "tracks.csv"),
        grid=read_map(path / "map.yaml"),
        cov_map=_covariances_of(path / "covariances.npz", stamps),
        summary=summary,
    )


def _covariances_of(path: Path, stamps: FloatArray) -> FloatArray | None:
    if not path.exists():
        return None
    own_stamps, cov_map = read_covariances(path)
    _check_times(path, own_stamps, stamps)
    return cov_map


def _check_times(path: Path, stamps: FloatArray, of_run: FloatArray) -> None:
    if len(stamps) != len(of_run) or not have_same_times(stamps, of_run):
        raise InputError(
            f"{path}: its scans are not those of trajectory.tum beside it; were files of two runs mixed?"
        )
