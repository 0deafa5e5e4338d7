"""The folder of a map that no log was run for: merged, or edited."""

from collections.abc import Sequence
from pathlib import Path

from slammot_graph.core.results import GridMap
from slammot_graph.core.saved_map import MAP_FILE, SavedMap
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import replacing, write_text
from slammot_graph.run_folder.g2o import write_graph
from slammot_graph.run_folder.map_files import write_map
from slammot_graph.run_folder.tum import write_trajectory

CLOSURES_FILE = "closures.csv"


def write_map_folder(
    output: Path,
    saved: SavedMap,
    grid: GridMap,
    stamps: FloatArray,
    T_map_base: FloatArray,
    closures: Sequence[Sequence[object]] = (),
    header: Sequence[str] = (),
) -> None:
    """Write ``map.slam``, ``graph.g2o``, ``trajectory.tum``, the map, and rows of ``closures.csv`` if there are any.

    Parameters
    ----------
    output : Path
        A folder that is there and claimed.
    saved : SavedMap
    grid : GridMap
    stamps : (n,) array [s]
    T_map_base : (n, 3) array
        One run after the other; without any there is no ``trajectory.tum``.
    closures : sequence of rows
    header : sequence of str
        Names of their columns.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    with replacing(output / MAP_FILE) as temporary:
        temporary.write_bytes(saved.to_bytes())
    write_graph(output / "graph.g2o", saved.nodes, saved.edges)
    if len(stamps):
        write_trajectory(output / "trajectory.tum", stamps, T_map_base)
    if header:
        write_text(output / CLOSURES_FILE, [",".join(header), *(",".join(map(str, row)) for row in closures)])
    write_map(output / "map.pgm", output / "map.yaml", grid)
