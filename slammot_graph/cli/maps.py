"""The commands that work on saved maps: `merge` and `edit`."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from slammot_graph.cli.console import EXIT_OK, figure_table, number, print_table, stderr, stdout
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.results import GridMap
    from slammot_graph.core.saved_map import SavedMap
    from slammot_graph.core.types import FloatArray
    from slammot_graph.saved_maps import RunClosure


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A folder's map and its trajectory, which may have no poses."""

    folder: Path
    saved: "SavedMap"
    stamps: "FloatArray"
    T_map_base: "FloatArray"


CLOSURE_COLUMNS = (
    *("from_run", "to_run", "from_node", "to_node", "from_scan", "to_scan"),
    *("x", "y", "yaw", "std_x", "std_y", "std_yaw", "residual2"),
)


def merge_command(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(name="DIR", metavar="DIR ...")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    overwrite: bool = False,
) -> int:
    """Merge the maps of several runs over one building into one, in the frame of the first.

    Parameters
    ----------
    folders
        Run folders with a map.slam, of one robot or several; two at least.
    output
        The folder to write: map.slam, map.pgm, map.yaml, graph.g2o, trajectory.tum, closures.csv.
    overwrite
        Replace a run that is already in the folder.
    """
    from slammot_graph.run_folder.directory import claimed_output
    from slammot_graph.saved_maps import closures_between_runs, merge_maps

    if len(folders) < 2:
        raise InputError("merge: name the folders of two runs at least")
    _check_apart(output, folders)
    parts = [_read(folder) for folder in folders]
    merged = merge_maps([part.saved for part in parts], names=[str(folder) for folder in folders])
    closures = closures_between_runs(merged.saved)
    with claimed_output(output, overwrite=overwrite):
        _write(output, merged.saved, list(zip(parts, merged.first_nodes, strict=True)), closures)
    names = [run.log or f"run {k + 1}" for k, run in enumerate(merged.saved.runs)]
    table = figure_table(
        "Loop closures between the runs",
        *("runs", "closures", "std [m]", "std [rad]", "median of squared residuals (3 degrees of freedom)"),
    )
    for pair in sorted({(closure.from_run, closure.to_run) for closure in closures}):
        own = [closure for closure in closures if (closure.from_run, closure.to_run) == pair]
        std = np.median([closure.std for closure in own], axis=0)
        table.add_row(
            f"{names[pair[0]]} - {names[pair[1]]}",
            str(len(own)),
            number(float(np.hypot(std[0], std[1])), 4),
            number(float(std[2]), 4),
            number(float(np.median([closure.residual2 for closure in own])), 1),
        )
    print_table(table)
    _tell(output, merged.saved)
    return EXIT_OK


def edit_command(
    folder: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    reject_closure: Annotated[tuple[str, ...], tyro.conf.arg(metavar="A-B ...")] = (),
    add_closure: Annotated[tuple[str, ...], tyro.conf.arg(metavar="A-B ...")] = (),
    erase: Annotated[
        tuple[tuple[float, float, float, float], ...], tyro.conf.arg(metavar="X0 Y0 X1 Y1 ...")
    ] = (),
    overwrite: bool = False,
) -> int:
    """Edit a saved map: closures out and in, places erased; it is optimised anew.

    Parameters
    ----------
    folder
        A run folder with a map.slam.
    output
        The folder to write: map.slam, map.pgm, map.yaml, graph.g2o, trajectory.tum.
    reject_closure
        Take out the closure between two nodes of graph.g2o, as 12-80.
    add_closure
        Search for how the local maps of two nodes lie to each other, and tie them.
    erase
        Take out what stands in a rectangle, by two opposite corners [m, frame of the new map].
    overwrite
        Replace a run that is already in the folder.
    """
    from slammot_graph.run_folder.directory import claimed_output
    from slammot_graph.saved_maps import edit_map

    rejected, added = _pairs("--reject-closure", reject_closure), _pairs("--add-closure", add_closure)
    if not (rejected or added or erase):
        raise InputError(
            "edit: nothing to do; give --reject-closure A-B, --add-closure A-B or --erase X0 Y0 X1 Y1"
        )
    _check_apart(output, [folder])
    part = _read(folder)
    edited = edit_map(part.saved, reject_closures=rejected, add_closures=added, erase=erase)
    with claimed_output(output, overwrite=overwrite):
        _write(output, edited, [(part, 0)])
    _tell(output, edited)
    return EXIT_OK


def _pairs(option: str, words: tuple[str, ...]) -> list[tuple[int, int]]:
    """Read nodes given as A-B."""
    pairs = []
    for word in words:
        found = re.fullmatch(r"(\d{1,9})-(\d{1,9})", word)
        if found is None:
            raise InputError(f"{option} {word}: must be two numbers of nodes, as 12-80")
        pairs.append((int(found[1]), int(found[2])))
    return pairs


def _check_apart(output: Path, folders: "tuple[Path, ...] | list[Path]") -> None:
    """Refuse to write over what is read."""
    for folder in folders:
        source = folder if folder.is_dir() else folder.parent
        if source.resolve() == output.resolve():
            raise InputError(f"{output}: is also read; name another --output")


def _read(folder: Path) -> _Part:
    """Read a folder's map and, where there is one, its trajectory."""
    from slammot_graph.core.saved_map import SavedMap
    from slammot_graph.run_folder.tum import read_trajectory

    saved, path = SavedMap.load(folder), folder / "trajectory.tum"
    stamps, poses = read_trajectory(path) if path.is_file() else (np.empty(0), np.empty((0, 3)))
    return _Part(folder=folder, saved=saved, stamps=stamps, T_map_base=poses)


def _write(
    output: Path,
    saved: "SavedMap",
    parts: list[tuple[_Part, int]],
    closures: "list[RunClosure] | None" = None,
) -> None:
    """Write the folder of a map; `parts` are what it was made of, each with its first node."""
    from slammot_graph.run_folder.map_folder import write_map_folder
    from slammot_graph.saved_maps import moved_trajectory

    poses, first_scans = [], {}
    n = 0
    for part, first in parts:
        for run in part.saved.runs:
            is_shown = len(part.stamps) > 0 and run.first_scan >= 0
            first_scans[first + run.first_node] = n + run.first_scan if is_shown else -1
        nodes = saved.nodes[first : first + len(part.saved.nodes)]
        if len(part.stamps):
            poses.append(moved_trajectory(part.T_map_base, part.saved, nodes, str(part.folder)))
        n += len(part.stamps)
    runs = tuple(replace(run, first_scan=first_scans[run.first_node]) for run in saved.runs)
    saved = replace(saved, runs=runs)
    rows = [
        [getattr(closure, name) for name in CLOSURE_COLUMNS[:6]]
        + [f"{value:.6g}" for value in (*closure.T_from_to, *closure.std, closure.residual2)]
        for closure in closures or ()
    ]
    write_map_folder(
        output,
        saved,
        _rendered(saved),
        np.concatenate([part.stamps for part, _ in parts]),
        np.vstack([np.empty((0, 3)), *poses]),
        rows,
        CLOSURE_COLUMNS if closures is not None else (),
    )


def _rendered(saved: "SavedMap") -> "GridMap":
    """Draw the map; where it is too large for one picture, what fits, with a warning."""
    from slammot_graph.mapping.saved_grid import render_saved_map
    from slammot_graph.mapping.tiled_grid import PartialMapError
    from slammot_graph.methods import get_method
    from slammot_graph.pipeline_config import PipelineConfig

    config = get_method("graph").config
    assert isinstance(config, PipelineConfig)
    try:
        return render_saved_map(saved, config.grid, config.final_map)
    except PartialMapError as error:
        stderr().print(f"warning: {error}", soft_wrap=True)
        return error.grid


def _tell(output: Path, saved: "SavedMap") -> None:
    runs = "1 run" if len(saved.runs) == 1 else f"{len(saved.runs)} runs"
    stdout().print(
        f"{output}: {runs}, {len(saved.nodes):,} nodes, {len(saved.submaps):,} local maps", soft_wrap=True
    )
