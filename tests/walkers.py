"""The first scans of two simulated walkers, as a log file."""

from pathlib import Path

from slammot_graph.logs import write_npz_log
from slammot_graph.simulation import simulate


def write_walkers(path: Path, n_scans: int) -> Path:
    """Write them with their truth."""
    arrays = simulate("two-walkers", seed=0).arrays()
    for key in ("stamps", "ranges", "odometry", "poses", "is_moving", "object_id", "objects"):
        arrays[key] = arrays[key][:n_scans]
    write_npz_log(path, **arrays)
    return path
