"""The commands that evaluate runs: `evaluate` and `compare`."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.table import Table

from slammot_graph.cli.console import (
    EXIT_OK,
    command,
    figure_table,
    mean_and_std,
    number,
    print_table,
    stderr,
    stdout,
)
from slammot_graph.cli.files import prepare_file
from slammot_graph.cli.reading import open_log_of_run
from slammot_graph.cli.running import RerunMode
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.types import FloatArray
    from slammot_graph.evaluation import ComparedRun, RelationScores, TruePath


def evaluate_command(
    directory: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    relations: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    truth: Annotated[Path | None, tyro.conf.arg(metavar="FILE.tum|npz")] = None,
    max_duration: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0,
    mot: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Compare a run with the truth: its trajectory, and with a simulated log also its moving points and its tracks.

    A track counts where at least 3 valid beams hit the object, and follows it within 0.5 m; who was out of sight for
    more than 3 s comes back as a new appearance; drift of the map does not count as an error of the tracks.

    Parameters
    ----------
    directory
        The run folder.
    relations
        Lines "t1 t2 x y z roll pitch yaw" (Kuemmerle et al. 2009).
    truth
        Lines "stamp x y z qx qy qz qw", or an .npz log with `poses`; poses belong together within 0.01 s. A log that
        knows its `is_moving`, `object_id` and `objects` also judges points and tracks.
    max_duration
        Show also the relations whose ends lie within this time of each other [s].
    mot
        Write tracks and truth in the MOTChallenge format into the folders `online` and `final` of this one.
    """
    if mot is not None and (truth is None or truth.suffix != ".npz"):
        raise InputError("--mot needs the true states of the objects: name --truth LOG.npz")
    if relations is None and truth is None:
        raise InputError("evaluate needs a ground truth: name --relations FILE or --truth FILE.tum")
    if not max_duration > 0.0:
        raise InputError(f"--max-duration must be a positive time in seconds, not {max_duration:g}")
    tables = []
    if relations is not None:
        tables.append(_relation_table(directory, relations, max_duration))
    if truth is not None:
        tables.append(_truth_table(directory, truth))
        if truth.suffix == ".npz":
            tables += _object_tables(directory, truth, mot)
    for table in tables:
        stdout().print(table)
    return EXIT_OK


def _relation_table(directory: Path, relations: Path, max_duration: float) -> Table:
    from slammot_graph.evaluation import evaluate_relations, read_relations
    from slammot_graph.run_folder.tum import read_trajectory

    true = read_relations(relations)
    path = directory / "trajectory.tum"
    stamps, T_map_base = read_trajectory(path)
    everything = evaluate_relations(stamps, T_map_base, true)
    if everything.translation_m.n == 0:
        raise _none_matches(relations, everything, path)
    short = evaluate_relations(stamps, T_map_base, true, max_duration_s=max_duration)
    table = figure_table(
        f"Relations of {relations.name} in {directory}",
        "relations",
        *("n", "unmatched", "translation [m]", "median", "rotation [deg]", "median"),
        no_wrap=True,
    )
    table.add_row("all", *_relation_cells(everything))
    table.add_row(f"within {max_duration:g} s", *_relation_cells(short))
    return table


def _truth_table(directory: Path, truth: Path) -> Table:
    """Absolute trajectory error (ATE) of the poses that have a true one, after alignment."""
    from slammot_graph.evaluation import MAX_DIFFERENCE_S, evaluate_truth, read_truth
    from slammot_graph.logs import open_log
    from slammot_graph.run_folder.tum import read_trajectory

    if truth.suffix == ".npz":
        true = read_truth(open_log(truth))
        true_stamps, T_world_base = true.stamps, true.T_world_base
    else:
        true_stamps, T_world_base = read_trajectory(truth)
    path = directory / "trajectory.tum"
    stamps, T_map_base = read_trajectory(path)
    scores = evaluate_truth(stamps, T_map_base, true_stamps, T_world_base)
    error = scores.error
    if error.translation_m.n == 0:
        raise InputError(
            f"{truth}: none of its {len(true_stamps)} poses lies within {MAX_DIFFERENCE_S:g} s of one in {path};"
            " is it of the same log, and by the same clock?"
        )
    table = figure_table(
        f"ATE of {directory} against {truth.name}, aligned",
        "error",
        *("n", "unmatched", "rmse", "mean +- std", "median", "max"),
        no_wrap=True,
    )
    for name, stats in (("position [m]", error.translation_m), ("heading [deg]", error.rotation_deg)):
        figures = number(stats.rmse, 4), mean_and_std(stats), number(stats.median, 4), number(stats.max, 4)
        table.add_row(name, str(stats.n), str(scores.n_unmatched), *figures)
    return table


def _object_tables(directory: Path, truth: Path, mot: Path | None) -> list[Table]:
    """Moving points and tracks, where the log knows them; writes them to a folder."""
    from slammot_graph.core.results import TRACK_COLUMNS
    from slammot_graph.core.stamps import have_same_times
    from slammot_graph.evaluation import (
        estimated_tracks,
        evaluate_objects,
        evaluate_points,
        read_objects,
        write_mot_challenge,
    )
    from slammot_graph.logs import open_log
    from slammot_graph.run_folder.reader import read_run_folder
    from slammot_graph.run_folder.tracks import ONLINE_COLUMNS, read_track_columns

    run, log = read_run_folder(directory), open_log(truth)
    if run.points is None:
        return []
    scans = [scan for scan, _ in zip(log, run.stamps, strict=False)]
    if not have_same_times(run.stamps, np.array([scan.stamp for scan in scans])):
        text = f"warning: {truth} has other scans than the run: its points and tracks are not judged"
        stderr().print(text, soft_wrap=True)
        return []
    tables, points = [], run.points
    labels = [None if scan.truth is None else scan.truth.is_moving for scan in scans]
    known = [one for one in labels if one is not None and len(one) == points.is_moving.shape[1]]
    if known and len(known) == len(labels):
        table = figure_table(
            f"Moving points of {directory} against {truth.name}",
            "labels",
            *("precision", "recall", "IoU", "static points kept"),
            no_wrap=True,
        )
        for name, found in (("online", points.is_moving_online), ("final", points.is_moving)):
            one = evaluate_points(found, np.array(known), points.is_valid)
            figures = (one.precision, one.recall, one.iou, one.static_kept)
            table.add_row(name, *(number(figure, 4) for figure in figures))
        tables.append(table)
    objects = read_objects(scans, points.is_valid)
    if objects is None:
        if mot is not None:
            raise InputError(f"{truth} does not know the true states of the objects, which --mot needs")
        return tables
    table = figure_table(
        f"Tracks of {directory} against {truth.name}, per appearance (per person)",
        "tracks",
        *("MOTA", "IDF1", "HOTA", "ids", "position [m]", "velocity [m/s]", "NEES of 2"),
        no_wrap=True,
    )
    online = read_track_columns(directory / "tracks_online.csv", (*TRACK_COLUMNS[:-1], *ONLINE_COLUMNS))
    for name, rows, poses in (("online", online[:, :9], online[:, 10:]), ("final", run.tracks, None)):
        if name == "online" and not (directory / "tracks_online.csv").exists():
            continue
        estimate = estimated_tracks(run.stamps, run.T_map_base, rows, poses)
        if mot is not None:
            write_mot_challenge(mot / name, objects, estimate)
        scores = evaluate_objects(objects, estimate)
        by_appearance, by_person = scores.appearance, scores.person
        table.add_row(
            name,
            number(by_appearance.mota, 3),
            f"{number(by_appearance.idf1, 3)} ({number(by_person.idf1, 3)})",
            f"{number(by_appearance.hota, 3)} ({number(by_person.hota, 3)})",
            f"{number(scores.ids_per_appearance, 2)} ({number(scores.ids_per_object, 2)})",
            number(scores.position_rmse_m, 3),
            number(scores.velocity_rmse_m_s, 3),
            number(scores.nees, 2),
        )
    return [*tables, table]


def compare_command(
    directories: Annotated[
        tuple[Path, ...], tyro.conf.arg(metavar="DIR DIR ...", help_behavior_hint="(two or more)")
    ],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="FILE.rrd")] = Path("compare.rrd"),
    relations: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    truth: Annotated[Path | None, tyro.conf.arg(metavar="LOG.npz")] = None,
    rerun: RerunMode = "file",
) -> int:
    """Compare several runs over one log, in a table and in one recording.

    Moving points are shown of the runs whose log is still at its path in the run folder, or is named as --truth.

    Parameters
    ----------
    directories
        Their run folders; the others are aligned with the start of the first.
    output
        The recording to write, for `slammot-graph view`.
    relations
        True relations, as for `slammot-graph evaluate`.
    truth
        The log with its true poses; by default the runs' own log, if it was simulated.
    rerun
        Record a file, stream to a viewer, or neither.
    """
    if len(directories) < 2:
        raise InputError("compare needs at least two run folders")
    if output.suffix != ".rrd":
        raise InputError(f"{output}: the name of --output must end in .rrd")

    from slammot_graph.evaluation import compare, find_truth, read_relations, read_truth
    from slammot_graph.logs import open_log
    from slammot_graph.run_folder.reader import read_run_folder

    folders = [read_run_folder(directory) for directory in directories]
    true_relations = None if relations is None else read_relations(relations)
    truth_path = find_truth(folders) if truth is None else read_truth(open_log(truth))
    runs = compare(folders, relations=true_relations, truth=truth_path)
    for run in runs:
        if relations is not None and run.relations is not None and run.relations.translation_m.n == 0:
            raise _none_matches(relations, run.relations, run.folder.path / "trajectory.tum")
    rows = _compared_rows(runs)
    if rerun != "off":
        _record(runs, truth_path, rows, output=output if rerun == "file" else None)
    heading, *cells = rows
    against = "" if truth_path is None else f", against the true poses in {truth_path.path.name}"
    table = figure_table(f"{len(runs)} runs, {len(folders[0].stamps)} scans in the first{against}", *heading)
    for row in cells:
        table.add_row(*row)
    print_table(table)
    if rerun == "file":
        stdout().print(f"recording: {output} (open it with: {command('view', output)})", soft_wrap=True)
    return EXIT_OK


def _compared_rows(runs: "list[ComparedRun]") -> list[list[str]]:
    """Headings, and the figures of each run."""
    columns: dict[str, Callable[[ComparedRun], str]] = {
        "run": lambda run: run.name,
        "scans": lambda run: str(len(run.folder.stamps)),
        "closures": lambda run: number(run.folder.figure("n_loop_closures"), 0),
        "failed matches": lambda run: number(run.folder.figure("n_failed_matches"), 0),
        "ms per scan": lambda run: number(run.folder.figure("stages_ms", "step", "median"), 2),
    }
    has_truth = not math.isnan(runs[0].ate_rmse_m)
    if has_truth:  # the first run need not be a good one
        columns["from the truth, rms [m]"] = lambda run: number(run.truth_rms_m, 4)
    else:
        columns["from the first, rms [m]"] = lambda run: number(run.distance_rms_m, 4)
    scores = {run.name: run.relations for run in runs if run.relations is not None}
    if scores:
        columns["relation error [m]"] = lambda run: number(scores[run.name].translation_m.mean, 4)
        columns["relation error [deg]"] = lambda run: number(scores[run.name].rotation_deg.mean, 3)
    if has_truth:
        columns["ATE rmse [m]"] = lambda run: number(run.ate_rmse_m, 4)
    return [list(columns), *([cell(run) for cell in columns.values()] for run in runs)]


def _none_matches(relations: Path, scores: "RelationScores", trajectory: Path) -> InputError:
    return InputError(
        f"{relations}: none of its {scores.n_relations} relations has both times in {trajectory};"
        " is it of the same log?"
    )


def _record(
    runs: "list[ComparedRun]", truth: "TruePath | None", rows: list[list[str]], *, output: Path | None
) -> None:
    """Write a comparison into a file, or show it in a viewer."""
    from slammot_graph.evaluation import true_path
    from slammot_graph.run_folder.atomic import atomic_path
    from slammot_graph.viz.rerun.comparison import record_comparison

    heading, *cells = rows
    lines = [heading, ["---"] * len(heading), *cells]
    summary = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    T_ref_base_true = None if truth is None else true_path(runs, truth)
    moving = _moving_points(runs, truth)
    if output is None:
        record_comparison(runs, T_ref_base_true=T_ref_base_true, moving=moving, summary=summary, spawn=True)
        return
    prepare_file(output)
    with atomic_path(output) as path:
        record_comparison(runs, T_ref_base_true=T_ref_base_true, moving=moving, summary=summary, path=path)


def _moving_points(runs: "list[ComparedRun]", truth: "TruePath | None") -> "dict[str, list[FloatArray]]":
    """Find the moving points of the runs whose log can still be read; a run folder holds only their labels."""
    from slammot_graph.core.saved_run import moving_points

    found = {}
    for run in runs:
        path = run.folder.log if truth is None else truth.path
        if path is None or run.folder.points is None:
            continue
        try:
            found[run.name] = moving_points(run.folder, open_log_of_run(run.folder, path))
        except InputError as error:
            stderr().print(f"warning: no moving points of {run.name}: {error}", soft_wrap=True)
    return found


def _relation_cells(scores: "RelationScores") -> list[str]:
    return [
        str(scores.translation_m.n),
        str(scores.n_unmatched),
        mean_and_std(scores.translation_m),
        number(scores.translation_m.median, 4),
        mean_and_std(scores.rotation_deg),
        number(scores.rotation_deg.median, 3),
    ]
