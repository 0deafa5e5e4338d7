"""The commands that run methods: `run` and `demo`."""

import contextlib
import errno
import math
import signal
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal, cast

import tyro

from slammot_graph.cli.console import (
    EXIT_INTERRUPTED,
    EXIT_OK,
    check_max_scans,
    command,
    figure_table,
    number,
    printed_deprecations,
    scan_progress,
    stderr,
    stdout,
    warn,
    warn_of,
)
from slammot_graph.cli.keeping import Keeping
from slammot_graph.cli.logs import write_simulation
from slammot_graph.cli.reading import DEFAULT_READING, Reading
from slammot_graph.cli.run_table import Outcome, run_table
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.results import RunResult
    from slammot_graph.core.saved_map import MapStart
    from slammot_graph.logs import LaserLog
    from slammot_graph.observer import Observer
    from slammot_graph.run import Run

DEMO_METHODS = ("odometry", "icp", "docpfo", "graph")
DEMO_SEED = 0

SHOWN = ("scan_topic", "odom_topic", "imu_topic", "odom_frame", "base_frame", "odometry")
"""What of the log's source the table shows."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says of a disk that is full, or of more than a user may have on it."""

RerunMode = Literal["file", "spawn", "off"]


def run_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph",
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    max_range: Annotated[float, tyro.conf.arg(metavar="M")] = math.inf,
    max_scans: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    reading: Reading = DEFAULT_READING,
    map_folder: Annotated[Path | None, tyro.conf.arg(name="map", metavar="DIR")] = None,
    localize: bool = False,
    initial_pose: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y YAW")] = None,
    rerun: RerunMode = "file",
    overwrite: bool = False,
    resume: bool = False,
    checkpoint_every: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0,
) -> int:
    """Run a method over a log and write its run folder.

    Parameters
    ----------
    log
        CARMEN (.log .clf, also .gz .bz2), ROS 1 .bag, a ROS 2 bag folder, .db3 or .mcap, .npz.
    output
        The run folder to write.
    method
        One of those that `slammot-graph methods` lists.
    config
        Settings in place of the method's own; `slammot-graph config` prints them all.
    max_range
        Leave aside what is farther [m]; by default as the settings say.
    max_scans
        Take the log's first ones only.
    reading
        What of the log is read, and how.
    map_folder
        Start from the map of this run's folder (map.slam): find the robot in it, and go on with it.
    localize
        Find and follow the robot in that map, which stays as it is.
    initial_pose
        About where in that map the log begins [m, m, rad]; by default anywhere.
    rerun
        Record run.rrd, stream to a viewer, or neither.
    overwrite
        Replace a run that is already in the folder.
    resume
        Go on with the interrupted run in the folder, given all else as it was begun; begin where there is none.
    checkpoint_every
        How often to write what such a run goes on from [s], at most 2 % of the time; 0: never.
    """
    from slammot_graph.core.config import load_config
    from slammot_graph.logs import source_of
    from slammot_graph.methods import get_method

    check_max_scans(max_scans)
    if not checkpoint_every >= 0.0:
        raise InputError(f"--checkpoint-every must be 0 or more seconds, not {checkpoint_every}")
    if resume and overwrite:
        raise InputError(
            "--resume goes on with the run in the folder, --overwrite replaces it; pass one of them"
        )
    settings = get_method(method).config
    if config is not None:
        with printed_deprecations():
            settings = load_config(config, settings)
    opened = reading.open(log)
    if method == "odometry" and source_of(opened).get("odometry") is not None:
        raise InputError(
            f"{log}: no odometry, and the method odometry has nothing else; take another, as graph"
        )

    from slammot_graph.diagnosis import inspect_first, limits_of
    from slammot_graph.run import Run

    keeping = Keeping(output, every_s=checkpoint_every, resume=resume)
    run = Run(
        opened,
        method,
        config=settings,
        max_range_m=None if math.isinf(max_range) else max_range,
        max_scans=max_scans,
        observers=_observers(output, rerun, keeping.recording_id),
        start=_map_start(map_folder, localize, initial_pose),
    )
    opened = cast("LaserLog", run.log)
    early = inspect_first(opened, limits_of(run.config))
    warn_of(opened, early)
    outcome = _execute(run, opened, output, overwrite=overwrite, keeping=keeping)
    told = {finding.kind for finding in early}
    warn_of(opened, [finding for finding in outcome.result.verdict if finding.kind not in told])
    if run.start is not None and (outcome.result.health == "lost").all():
        stderr().print(
            f"warning: the robot was not found in {map_folder}; its poses are in a frame of their own, where its first"
            " pose is the origin; drive farther, through places that the map has seen, or give --initial-pose",
            soft_wrap=True,
        )
    stdout().print(run_table(outcome))
    if outcome.failure is not None:
        raise outcome.failure
    return EXIT_INTERRUPTED if outcome.was_interrupted else EXIT_OK


def _map_start(
    folder: Path | None, localize: bool, initial_pose: tuple[float, float, float] | None
) -> "MapStart | None":
    """Read the map that a run starts from, if there is one."""
    import numpy as np

    from slammot_graph.core.saved_map import MapStart, SavedMap

    if folder is None:
        if localize or initial_pose is not None:
            raise InputError(
                "--localize and --initial-pose need --map DIR, the folder of the run whose map it is"
            )
        return None
    pose = None if initial_pose is None else np.array(initial_pose)
    if pose is not None and not np.isfinite(pose).all():
        raise InputError("--initial-pose must be three finite numbers: x y [m] and yaw [rad]")
    return MapStart(saved=SavedMap.load(folder), localize=localize, initial_pose=pose)


def demo_command(*, output: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/demo")) -> int:
    """Simulate two walkers, run the wheels alone, the paper's methods and ours, and compare them.

    Parameters
    ----------
    output
        Where the log and a run folder per method go; the demo's own earlier ones are replaced.
    """
    from slammot_graph.logs import open_log
    from slammot_graph.run import Run

    path = output / "log.npz"
    write_simulation("two-walkers", path, seed=DEMO_SEED, people=None, noise_scale=1.0)
    log = open_log(path)
    table = figure_table(
        "Two walkers who stop before the robot does, simulated",
        "method",
        *("ATE rmse [m]", "precision", "recall", "IoU (final labels)", "ms per scan (median)"),
    )
    for method in DEMO_METHODS:
        run = Run(log, method, observers=_observers(output / method, "file"))
        outcome = _execute(run, log, output / method, overwrite=True)
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.was_interrupted:
            return EXIT_INTERRUPTED
        table.add_row(method, *_truth_cells(outcome.result, log))
    out = stdout()
    out.print(table)
    out.print(
        f"one log (seed {DEMO_SEED}); medians over 20 seeds stand in README.md. Precision, recall and IoU are of the"
        " moving points by the final labels, which `graph` gives by a backward pass",
        soft_wrap=True,
    )
    recording = output / "graph" / "run.rrd"
    out.print(f"recording: {recording} (open it with: {command('view', recording.parent)})", soft_wrap=True)
    out.print(f"picture:   {output / 'graph' / 'overview.png'}")
    return EXIT_OK


def _execute(
    run: "Run", log: "LaserLog", output: Path, *, overwrite: bool, keeping: Keeping | None = None
) -> Outcome:
    """Run to the end, or until Ctrl-C or an error; what was computed is written in any case."""
    from slammot_graph.run_folder.directory import claimed_output

    keeping = keeping or Keeping(output)
    with claimed_output(output, overwrite=overwrite, resume=keeping.resume):
        keeping.begin(run)
        _announce_compilation()
        failures: list[Exception] = []
        n_scans = 0
        with _interrupt_flag() as is_interrupted:
            try:
                with run, scan_progress(log, run.method, run.max_scans) as show:
                    steps = iter(run)  # held, so that leaving the run is what ends it
                    for _ in steps:
                        n_scans = run.n_scans
                        show(n_scans)
                        keeping.after_step()
                        if is_interrupted():
                            keeping.interrupted()
                            break
            except Exception as error:  # a truncated log, a full disk: first save, then say so
                if n_scans == 0:
                    raise
                failures.append(error)
            result = run.result()
            failures += keeping.failures()
            failures += _write(result, output, keeping)
        was_interrupted = is_interrupted()
        if not was_interrupted:
            keeping.end()
    warn(log)
    for text in result.failures:
        stderr().print(f"warning: could not be computed: {text}", soft_wrap=True)
    for other in failures[1:]:
        stderr().print(f"warning: {' '.join(str(other).split())}", soft_wrap=True)
    if failures or was_interrupted:
        why = "interrupted after" if not failures else "done with all" if run.is_complete else "stopped after"
        goes_on = "; --resume goes on" if keeping.can_go_on() else ""
        stderr().print(f"{why} {n_scans} scans; what was computed is in {output}{goes_on}", soft_wrap=True)
    return Outcome(
        result=result,
        run=run,
        log=log,
        output=output,
        was_interrupted=was_interrupted,
        failure=failures[0] if failures else None,
    )


def _write(result: "RunResult", output: Path, keeping: Keeping) -> list[Exception]:
    """Write what was computed, at the expense of the recording where the disk is full; returns what went wrong."""
    from slammot_graph.saving import write_run

    recording = output / "run.rrd"
    try:
        write_run(result, output)
    except Exception as error:
        is_full = isinstance(error.__cause__, OSError) and error.__cause__.errno in FULL
        if not is_full:
            return [error]
        keeping.end()
        if not recording.exists():
            return _written(result, output)
    else:
        return []
    try:
        recording.unlink()
        write_run(result, output)
    except Exception as error:
        return [error]
    return [
        InputError(f"{recording}: removed, to make room for the results; free some space or pass --rerun off")
    ]


def _written(result: "RunResult", output: Path) -> list[Exception]:
    from slammot_graph.saving import write_run

    try:
        write_run(result, output)
    except Exception as error:
        return [error]
    return []


@cache
def _announce_compilation() -> None:
    """Say, once per process, why the first scan takes its time where the machine code is not there yet."""
    from slammot_graph import run

    if not run.has_compiled_kernels():
        stderr().print(
            "compiling the kernels, once: the first scans take about half a minute", soft_wrap=True
        )


def _observers(output: Path, mode: RerunMode, recording_id: str | None = None) -> "list[Observer]":
    """Make what watches a run: its recording, unless there is none."""
    if mode == "off":
        return []
    from slammot_graph.viz.rerun.run import RerunRecording

    path = output / "run.rrd" if mode == "file" else None
    return [RerunRecording(path=path, spawn=mode == "spawn", recording_id=recording_id)]


@contextlib.contextmanager
def _interrupt_flag() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a question that the loop may ask; the second one stops at once."""
    is_interrupted = False

    def ask_to_stop(_signal: int, _frame: FrameType | None) -> None:
        nonlocal is_interrupted
        if is_interrupted:
            raise KeyboardInterrupt
        is_interrupted = True

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = signal.signal(signal.SIGINT, ask_to_stop)
    try:
        yield lambda: is_interrupted
    finally:
        signal.signal(signal.SIGINT, before)


def _truth_cells(result: "RunResult", log: "LaserLog") -> list[str]:
    """What the demo's table says of a run over a log with truth."""
    import numpy as np

    from slammot_graph.evaluation import absolute_error, evaluate_points

    truths = [scan.truth for scan in log if scan.truth is not None]
    T_world_base = np.array([truth.T_world_base for truth in truths])
    is_moving = np.array([truth.is_moving for truth in truths])
    points = evaluate_points(result.is_moving, is_moving, result.is_valid)
    return [
        number(absolute_error(result.T_map_base, T_world_base).translation_m.rmse, 4),
        number(points.precision, 3),
        number(points.recall, 3),
        number(points.iou, 3),
        number(float(np.median(result.stage_ms["step"])), 2),
    ]
