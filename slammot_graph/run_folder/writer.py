"""Write a run folder, each file atomically; one that cannot be written does not keep the others from it."""

from collections.abc import Callable
from pathlib import Path

from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_map import MAP_FILE
from slammot_graph.run_folder.atomic import write_errors
from slammot_graph.run_folder.covariances import write_covariances
from slammot_graph.run_folder.g2o import write_graph
from slammot_graph.run_folder.map_files import write_map
from slammot_graph.run_folder.points import write_points
from slammot_graph.run_folder.slam_map import write_slam_map
from slammot_graph.run_folder.summary import write_summary
from slammot_graph.run_folder.tracks import write_tracks, write_tracks_online
from slammot_graph.run_folder.tum import write_trajectory


def write_run_folder(output: str | Path, result: RunResult) -> None:
    """Write all files of a run but the recording and the picture: what is small and dear first, the map last.

    A method without a pose graph leaves no ``graph.g2o`` and no ``map.slam``.

    Parameters
    ----------
    output : str or Path
        The run folder; made if it is not there, and files of an earlier run in it are replaced.
    result : RunResult

    Raises
    ------
    InputError
        A file cannot be written; the text names it. All others were tried before.
    """
    output = Path(output)
    with write_errors(output, "name another --output"):
        output.mkdir(parents=True, exist_ok=True)

    def write_or_remove_graph() -> None:
        if len(result.nodes):
            write_graph(output / "graph.g2o", result.nodes, result.edges)
        else:
            with write_errors(output / "graph.g2o", "remove it yourself, or name another --output"):
                (output / "graph.g2o").unlink(missing_ok=True)

    def write_or_remove_slam_map() -> None:
        if result.saved_map is not None:
            write_slam_map(output / MAP_FILE, result.saved_map, result)
        else:
            with write_errors(output / MAP_FILE, "remove it yourself, or name another --output"):
                (output / MAP_FILE).unlink(missing_ok=True)

    write_each(
        lambda: write_trajectory(output / "trajectory.tum", result.stamps, result.T_map_base),
        lambda: write_summary(output / "summary.json", result),
        lambda: write_points(output / "points.npz", result),
        lambda: write_tracks(output / "tracks.csv", result),
        lambda: write_tracks_online(output / "tracks_online.csv", result),
        lambda: write_covariances(output / "covariances.npz", result),
        write_or_remove_graph,
        write_or_remove_slam_map,
        lambda: write_map(output / "map.pgm", output / "map.yaml", result.grid),
    )


def write_each(*writes: Callable[[], object]) -> None:
    """Try all in their order, whatever becomes of some of them; then raise the first error."""
    errors = []
    for write in writes:
        try:
            write()
        except Exception as error:  # what can be written must not be lost with it
            errors.append(error)
    if errors:
        raise errors[0]
