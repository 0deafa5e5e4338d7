"""``map.slam``: what later runs start from; the format is described in `core/saved_map.py`."""

from dataclasses import replace
from pathlib import Path

from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.run_folder.atomic import replacing


def write_slam_map(path: Path, saved: SavedMap, result: RunResult) -> None:
    """Write a run's map atomically, with the name of its log.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    if saved.runs and result.log.path is not None:
        named = replace(saved.runs[-1], log=result.log.path.name)
        saved = replace(saved, runs=(*saved.runs[:-1], named))
    with replacing(path) as temporary:
        temporary.write_bytes(saved.to_bytes())
