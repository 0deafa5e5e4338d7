"""``trajectory.tum``: lines ``stamp x y z qx qy qz qw``, of which the planar part is used."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.number_rows import read_number_rows
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import write_text

_N_COLUMNS = 8


def write_trajectory(path: Path, stamps: FloatArray, T_map_base: FloatArray) -> None:
    """Write stamps (n,) [s] and poses (n, 3) [m, m, rad] as a TUM trajectory.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_text(path, _lines(stamps, T_map_base))


def read_trajectory(path: str | Path) -> tuple[FloatArray, FloatArray]:
    """Read a TUM trajectory, this package's or another program's.

    Returns
    -------
    stamps : (n,) array [s]
    T_map_base : (n, 3) array [m, m, rad]

    Raises
    ------
    InputError
        The file is missing, or a line in it is not eight finite numbers.
    """
    path = Path(path)
    rows = read_number_rows(path, _N_COLUMNS)
    yaw = 2.0 * np.arctan2(rows[:, 6], rows[:, 7])
    return rows[:, 0], np.column_stack([rows[:, 1], rows[:, 2], se2.wrap_angle(yaw)])


def _lines(stamps: FloatArray, T_map_base: FloatArray) -> Iterator[str]:
    half = 0.5 * T_map_base[:, 2]
    columns = (stamps, T_map_base[:, 0], T_map_base[:, 1], np.sin(half), np.cos(half))
    for stamp, x, y, qz, qw in zip(*(column.tolist() for column in columns), strict=True):
        yield f"{stamp:.9f} {x:.9f} {y:.9f} 0 0 0 {qz:.9f} {qw:.9f}"
