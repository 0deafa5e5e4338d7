"""``covariances.npz``: the covariance of each pose, and the scan of each graph node."""

from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import check_npz
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import write_arrays


def write_covariances(path: Path, result: RunResult) -> None:
    """Write `stamps` (n,) [s], `cov_map` and `cov_anchor_base` (n, 3, 3), and `node_scans` (m,).

    `cov_map` is that of the poses of ``trajectory.tum`` in the map, the map's own error in it. `cov_anchor_base`, as
    known at the time, is relative to the local map that the scan was matched with; in a run that localizes, relative to
    the keyframes of the saved map around the robot.
    The vertex k of ``graph.g2o`` is the scan ``node_scans[k]``, counted from 0, which is also its line in
    ``trajectory.tum``.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_arrays(
        path,
        stamps=result.stamps,
        cov_map=result.cov_map,
        cov_anchor_base=result.cov_anchor_base,
        node_scans=result.node_scans.astype(np.int64),
    )


def read_covariances(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read `stamps` (n,) [s] and `cov_map` (n, 3, 3), right perturbation, order (x, y, theta).

    Raises
    ------
    InputError
        The file is not what a run writes.
    """
    check_npz(path)
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            stamps, cov_map = np.asarray(file["stamps"], float), np.asarray(file["cov_map"], float)
    except Exception:  # the decoders of a damaged file may raise anything
        raise InputError(f"{path}: not an .npz file of `stamps` and `cov_map`; run it again") from None
    if stamps.ndim != 1 or cov_map.shape != (len(stamps), 3, 3):
        raise InputError(
            f"{path}: `cov_map` has shape {cov_map.shape}, `stamps` {stamps.shape}; run it again"
        )
    with np.errstate(invalid="ignore"):
        if (np.diagonal(cov_map, axis1=1, axis2=2) < 0.0).any():
            raise InputError(f"{path}: `cov_map` holds negative variances; run it again")
    return stamps, cov_map
