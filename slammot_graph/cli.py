"""The command line ``slammot-graph``: each command is a function here, and `main` turns errors into exit codes.

Whatever is heavy (gtsam, rerun, matplotlib, kiss_icp) is imported by the command that needs it.
"""

import contextlib
import itertools
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal, TextIO

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from slammot_graph.errors import InputError, SlammotError

if TYPE_CHECKING:
    from slammot_graph.evaluation import ErrorStats, RelationScores
    from slammot_graph.logs import LaserLog
    from slammot_graph.recording import RunLog
    from slammot_graph.result_types import RunResult, StepResult
    from slammot_graph.run import Run
    from slammot_graph.simulation import SimulatedLog
    from slammot_graph.types import FloatArray

EXIT_OK, EXIT_USER_ERROR, EXIT_INTERRUPTED = 0, 2, 130
DEMO_METHODS = ("icp", "docpfo", "graph")
RUN_FILES = (
    "trajectory.tum",
    "points.npz",
    "tracks.csv",
    "map.pgm",
    "map.yaml",
    "graph.g2o",
    "covariances.npz",
    "run.rrd",
    "overview.png",
    "summary.json",
)
N_REASONS = 3
"""So many skipped scans and warnings are shown; the rest is counted."""
STAMP_TOLERANCE_S = 1e-6
"""Run folders write their stamps with nine decimals."""

RerunMode = Literal["file", "spawn", "off"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process if left out.

    Returns
    -------
    int
        0 if all went well, 2 after a user's mistake (with one line on stderr), 130 after Ctrl-C.
    """
    try:
        code: int = tyro.extras.subcommand_cli_from_dict(
            {
                "run": run_command,
                "methods": methods_command,
                "evaluate": evaluate_command,
                "config": config_command,
                "simulate": simulate_command,
                "inject": inject_command,
                "demo": demo_command,
            },
            prog="slammot-graph",
            description="2D laser SLAM among moving people, on a factor graph.",
            args=sys.argv[1:] if argv is None else argv,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        return code
    except SystemExit as stop:  # tyro has shown the help or what is wrong with the arguments
        return stop.code if isinstance(stop.code, int) else EXIT_USER_ERROR
    except SlammotError as error:
        return _complain(str(error))
    except BrokenPipeError:  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_USER_ERROR
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(f"{place}{error.strerror or error}")
    except KeyboardInterrupt:
        _stderr().print("interrupted")
        return EXIT_INTERRUPTED


def run_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph",
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    max_range: Annotated[float, tyro.conf.arg(metavar="M")] = math.inf,
    scan_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
    odom_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
    rerun: RerunMode = "file",
    overwrite: bool = False,
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
    scan_topic
        Which laser of a bag.
    odom_topic
        Which odometry of a bag.
    rerun
        Record run.rrd, stream to a viewer, or neither.
    overwrite
        Replace a run that is already in the folder.
    """
    from slammot_graph.config import load_config
    from slammot_graph.logs import open_log
    from slammot_graph.methods import get_method

    settings = get_method(method).config
    if config is not None:
        settings = load_config(config, settings)
    opened = open_log(log, scan_topic=scan_topic, odom_topic=odom_topic)

    from slammot_graph.run import Run

    run = Run(opened, method, config=settings, max_range_m=None if math.isinf(max_range) else max_range)
    outcome = _execute(run, output, rerun=rerun, overwrite=overwrite)
    _stdout().print(_run_table(outcome))
    return EXIT_INTERRUPTED if outcome.was_interrupted else EXIT_OK


def methods_command() -> int:
    """List the methods, each a rung of a ladder: what it is, and what it changes."""
    from slammot_graph.methods import METHODS

    table = Table("method", "what it is", title="Methods")
    for method in METHODS.values():
        table.add_row(method.name, method.summary)
    _stdout().print(table)
    return EXIT_OK


def evaluate_command(
    directory: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    relations: Annotated[Path, tyro.conf.arg(metavar="FILE")],
    max_duration: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0,
) -> int:
    """Compare a run's trajectory with true relations (Kuemmerle et al. 2009).

    Parameters
    ----------
    directory
        The run folder.
    relations
        Lines "t1 t2 x y z roll pitch yaw".
    max_duration
        Show also the relations whose ends lie within this time of each other [s].
    """
    from slammot_graph.evaluation import evaluate_relations, read_relations, read_trajectory

    if not max_duration > 0.0:
        raise InputError(f"--max-duration must be a positive time in seconds, not {max_duration:g}")
    true = read_relations(relations)
    path = directory / "trajectory.tum"
    stamps, T_map_base = read_trajectory(path)
    everything = evaluate_relations(stamps, T_map_base, true)
    if everything.translation_m.n == 0:
        raise InputError(
            f"{relations}: none of its {everything.n_relations} relations has both times in {path};"
            " is it of the same log?"
        )
    short = evaluate_relations(stamps, T_map_base, true, max_duration_s=max_duration)
    table = Table(title=f"Relations of {relations.name} in {directory}")
    for heading in ("relations", "n", "unmatched", "translation [m]", "median", "rotation [deg]", "median"):
        table.add_column(heading, justify="left" if heading == "relations" else "right", no_wrap=True)
    table.add_row("all", *_relation_cells(everything))
    table.add_row(f"within {max_duration:g} s", *_relation_cells(short))
    _stdout().print(table)
    return EXIT_OK


def config_command(*, method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph") -> int:
    """Print all settings of a method as TOML, to be changed and given to `run --config`.

    Parameters
    ----------
    method
        One of those that `slammot-graph methods` lists.
    """
    from slammot_graph.config import to_toml
    from slammot_graph.methods import get_method

    chosen = get_method(method)
    text = f"# slammot-graph run LOG --output DIR --method {chosen.name} --config FILE.toml\n"
    _stdout().print(text + to_toml(chosen.config), end="", soft_wrap=True)
    return EXIT_OK


def simulate_command(
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="LOG.npz")],
    seed: Annotated[int, tyro.conf.arg(metavar="S")] = 0,
    people: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    noise_scale: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0,
) -> int:
    """Simulate a log with exact truth for poses, beams and objects.

    Parameters
    ----------
    scenario
        Its name; a wrong one lists those that there are.
    output
        The log to write.
    seed
        Equal seeds give equal logs.
    people
        How many, in place of the scenario's own number.
    noise_scale
        Multiply the errors of the odometry by this.
    """
    _write_simulation(scenario, output, seed=seed, people=people, noise_scale=noise_scale)
    return EXIT_OK


def inject_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    people: Annotated[int, tyro.conf.arg(metavar="N")],
    seed: Annotated[int, tyro.conf.arg(metavar="S")] = 0,
    output: Annotated[Path, tyro.conf.arg(metavar="LOG.npz")],
    reference: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    max_scans: Annotated[int | None, tyro.conf.arg(metavar="K")] = None,
    scan_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
    odom_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
) -> int:
    """Copy a recorded log with people in it who cross the beams, and exact labels of those beams.

    They walk where the log's own scans saw free space; all other beams stay as recorded.

    Parameters
    ----------
    log
        As for `slammot-graph run`.
    people
        How many.
    seed
        Equal seeds give equal logs.
    output
        The log to write; its poses are those of the reference.
    reference
        A run folder of the same log, whose trajectory says where the robot was; by default `graph` is run first.
    max_scans
        Take the log's first ones only.
    scan_topic
        Which laser of a bag.
    odom_topic
        Which odometry of a bag.
    """
    for name, value, least in (("people", people, 0), ("seed", seed, 0), ("max-scans", max_scans, 1)):
        if value is not None and value < least:
            raise InputError(f"--{name} must be at least {least}, not {value}")
    if output.suffix != ".npz":
        raise InputError(f"{output}: the name of --output must end in .npz")

    from slammot_graph.logs import open_log
    from slammot_graph.simulation import inject

    opened = open_log(log, scan_topic=scan_topic, odom_topic=odom_topic)
    if output.exists() and output.samefile(log):
        raise InputError(f"{output}: is the recorded log itself; name another --output")
    _prepare_file(output)
    T_map_base = (
        _run_reference(opened, max_scans)
        if reference is None
        else _read_reference(reference, opened, max_scans)
    )
    made = inject(opened, T_map_base, n_people=people, seed=seed, max_scans=max_scans)
    _write_whole(made, output)
    _warn(opened)
    n_seen = len(set(made.object_id[made.is_moving].tolist()))
    share = made.is_moving.sum() / max(1, sum(int(scan.is_valid().sum()) for scan in made))
    _stderr().print(
        f"{log.name} with seed {seed} is in {output}: {made.n_scans} scans,"
        f" {people} people, {n_seen} of them seen, {share:.1%} of the valid beams on them",
        soft_wrap=True,
    )
    return EXIT_OK


def demo_command(*, output: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/demo")) -> int:
    """Simulate two walkers, run the paper's methods and ours over the log, and compare them.

    Parameters
    ----------
    output
        Where the log and a run folder per method go; the demo's own earlier ones are replaced.
    """
    from slammot_graph.logs import open_log
    from slammot_graph.run import Run

    path = output / "log.npz"
    _write_simulation("two-walkers", path, seed=0, people=None, noise_scale=1.0)
    log = open_log(path)
    table = Table(title="Two walkers who stop before the robot does, simulated")
    for heading in ("method", "ATE rmse [m]", "precision", "recall", "IoU", "ms per scan (median)"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for method in DEMO_METHODS:
        outcome = _execute(Run(log, method), output / method, rerun="file", overwrite=True)
        if outcome.was_interrupted:
            return EXIT_INTERRUPTED
        table.add_row(method, *_truth_cells(outcome.result, log))
    out = _stdout()
    out.print(table)
    out.print(
        f"recording: {output / 'graph' / 'run.rrd'} (open it with: rerun {output / 'graph' / 'run.rrd'})"
    )
    out.print(f"picture:   {output / 'graph' / 'overview.png'}")
    return EXIT_OK


# ------------------------------------------------------------------------------------------------- running


@dataclass(frozen=True, kw_only=True, eq=False)
class _Outcome:
    """What a run left behind."""

    result: "RunResult"
    log: "LaserLog"
    output: Path
    was_interrupted: bool


def _execute(run: "Run", output: Path, *, rerun: RerunMode, overwrite: bool) -> _Outcome:
    """Run to the end, or until Ctrl-C or an error; what was computed is written in any case."""
    from slammot_graph.results import prepare_output, write_run_folder

    prepare_output(output, overwrite=overwrite)
    failure: Exception | None = None
    n_scans = 0
    with (
        contextlib.closing(_make_run_log(run, output, rerun)) as run_log,
        _interrupt_flag() as is_interrupted,
    ):
        steps = iter(run)
        try:
            with _progress(run.log, run.method) as show:
                for n_scans, step in enumerate(steps, start=1):
                    _record(run, run_log, step)
                    show(n_scans)
                    if is_interrupted():
                        break
        except Exception as error:  # a truncated log, a full disk: first save, then say so
            if n_scans == 0:
                raise
            failure = error
        finally:
            if isinstance(steps, Generator):
                steps.close()
        result = run.result()
        write_run_folder(output, result)
        run_log.finish(result)
    _warn(run.log)
    if failure is not None or is_interrupted():
        why = "stopped" if failure is not None else "interrupted"
        _stderr().print(f"{why} after {n_scans} scans; what was computed is in {output}")
    if failure is not None:
        raise failure
    return _Outcome(result=result, log=run.log, output=output, was_interrupted=is_interrupted())


def _record(run: "Run", run_log: "RunLog", step: "StepResult") -> None:
    run_log.log_step(step)
    if run_log.wants_map:
        run_log.log_map(run.pipeline.render_map())
    if run_log.wants_graph:
        run_log.log_graph(*run.pipeline.nodes_and_edges())
    if run_log.wants_nodes:
        run_log.log_nodes(run.pipeline.nodes_and_edges()[0])


def _make_run_log(run: "Run", output: Path, mode: RerunMode) -> "RunLog":
    from slammot_graph.config import to_plain
    from slammot_graph.recording import NoRunLog, RerunLog

    if mode == "off":
        return NoRunLog()
    path = output / "run.rrd" if mode == "file" else None
    return RerunLog(path=path, spawn=mode == "spawn", method=run.method, config=to_plain(run.config))


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


def _write_simulation(
    scenario: str, output: Path, *, seed: int, people: int | None, noise_scale: float
) -> None:
    from slammot_graph.simulation import simulate

    _prepare_file(output)
    simulated = simulate(scenario, seed=seed, n_people=people, noise_scale=noise_scale)
    _write_whole(simulated, output)
    _stderr().print(f"{scenario} with seed {seed} is in {output}", soft_wrap=True)


def _run_reference(log: "LaserLog", max_scans: int | None) -> "FloatArray":
    """Where `graph` says that the robot was."""
    from slammot_graph.run import Run

    run = Run(log, "graph")
    steps = iter(run)
    try:
        with _progress(log, run.method, max_scans) as show:
            for n_scans, _ in enumerate(steps, start=1):
                show(n_scans)
                if n_scans == max_scans:
                    break
    finally:
        if isinstance(steps, Generator):
            steps.close()
    return run.result().T_map_base


def _read_reference(directory: Path, log: "LaserLog", max_scans: int | None) -> "FloatArray":
    """The trajectory of a run folder, which must be one of this log; `inject` looks at its length."""
    import numpy as np

    from slammot_graph.evaluation import read_trajectory

    stamps, T_map_base = read_trajectory(directory / "trajectory.tum")
    of_log = np.array([scan.stamp for scan in itertools.islice(log, max_scans)])
    if not len(of_log):
        raise InputError(f"{log.path}: none of its {log.n_scans} scans is usable")
    n = min(len(stamps), len(of_log))
    if not np.allclose(stamps[:n], of_log[:n], rtol=0.0, atol=STAMP_TOLERANCE_S):
        raise InputError(
            f"{directory}: its scans have other times than those of {log.path};"
            " name a run of this log as --reference"
        )
    return T_map_base


def _prepare_file(output: Path) -> None:
    """Find out that a log cannot be written before it is computed."""
    if output.exists() and not output.is_file():
        raise InputError(f"{output}: is no plain file; name another --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


def _write_whole(log: "SimulatedLog", output: Path) -> None:
    """Write a log under a temporary name and rename it: it is whole or not there."""
    unfinished = output.with_name(f".{output.name}.tmp")
    try:
        log.write(unfinished)
        unfinished.replace(output)
    finally:
        unfinished.unlink(missing_ok=True)


# ------------------------------------------------------------------------------------------------- showing


def _stdout() -> Console:
    return _console(sys.stdout)


def _stderr() -> Console:
    return _console(sys.stderr)


def _console(file: TextIO) -> Console:
    console = Console(file=file, markup=False, highlight=False, emoji=False)
    if not console.is_terminal:  # a file has no width: long paths stay on their line
        console.width = 200
    return console


def _complain(text: str) -> int:
    _stderr().print(f"slammot-graph: {' '.join(text.split())}", soft_wrap=True)
    return EXIT_USER_ERROR


@contextlib.contextmanager
def _progress(log: "LaserLog", method: str, max_scans: int | None = None) -> Iterator[Callable[[int], None]]:
    """Show how many scans are done: a bar, or where nobody watches a line at the start and one at the end."""
    console = _stderr()
    total = log.n_scans if max_scans is None else min(max_scans, log.n_scans)
    label = f"{method} on {log.path.name}"
    if console.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("scans"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(label, total=total)
            yield lambda n_scans: bar.update(task, completed=n_scans + len(log.skipped))
        return
    n_done, start = 0, time.monotonic()

    def count(n_scans: int) -> None:
        nonlocal n_done
        n_done = n_scans

    console.print(f"{label}: {total} scans", soft_wrap=True)
    yield count
    console.print(f"{label}: {n_done} scans in {time.monotonic() - start:.1f} s", soft_wrap=True)


def _warn(log: "LaserLog") -> None:
    console = _stderr()
    skipped = [f"{scan.place} skipped: {scan.reason}" for scan in log.skipped]
    for texts, what in ((log.warnings, "warnings"), (skipped, "skipped scans")):
        for text in texts[:N_REASONS]:
            console.print(f"warning: {log.path}: {text}", soft_wrap=True)
        if len(texts) > N_REASONS:
            console.print(f"warning: {log.path}: and {len(texts) - N_REASONS} more {what}", soft_wrap=True)


def _run_table(outcome: _Outcome) -> Table:
    import numpy as np

    result, log = outcome.result, outcome.log
    table = Table(title=f"{result.method} on {log.path.name}", show_header=False)
    step_ms = result.stage_ms.get("step", np.zeros(0))
    reasons = "; ".join(f"{scan.place}: {scan.reason}" for scan in log.skipped[:N_REASONS])
    table.add_row("scans", str(len(result.stamps)) + ("" if result.is_complete else " (not the whole log)"))
    table.add_row("skipped", f"{result.n_skipped}" + (f" ({reasons})" if reasons else ""))
    table.add_row("failed matches", str(result.n_failed_matches))
    table.add_row("nodes", str(len(result.nodes)))
    table.add_row("loop closures", str(sum(edge.kind == "closure" for edge in result.edges)))
    if step_ms.size:
        median, p95 = np.percentile(step_ms, [50, 95])
        table.add_row("ms per scan", f"{median:.2f} median, {p95:.2f} p95")
    for path in map(outcome.output.joinpath, RUN_FILES):
        if path.exists():
            table.add_row(path.name, str(path))
    return table


def _relation_cells(scores: "RelationScores") -> list[str]:
    return [
        str(scores.translation_m.n),
        str(scores.n_unmatched),
        _mean_and_std(scores.translation_m),
        _number(scores.translation_m.median, 4),
        _mean_and_std(scores.rotation_deg),
        _number(scores.rotation_deg.median, 3),
    ]


def _truth_cells(result: "RunResult", log: "LaserLog") -> list[str]:
    """What the demo's table says of a run over a log with truth."""
    import numpy as np

    from slammot_graph.evaluation import absolute_error, evaluate_points

    truths = [scan.truth for scan in log if scan.truth is not None]
    T_world_base = np.array([truth.T_world_base for truth in truths])
    is_moving = np.array([truth.is_moving for truth in truths])
    points = evaluate_points(result.is_moving, is_moving, result.is_valid)
    return [
        _number(absolute_error(result.T_map_base, T_world_base).translation_m.rmse, 4),
        _number(points.precision, 3),
        _number(points.recall, 3),
        _number(points.iou, 3),
        _number(float(np.median(result.stage_ms["step"])), 2),
    ]


def _mean_and_std(stats: "ErrorStats") -> str:
    return f"{_number(stats.mean, 4)} +- {_number(stats.std, 4)}"


def _number(value: float, n_decimals: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{n_decimals}f}"
