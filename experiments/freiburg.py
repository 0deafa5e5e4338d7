"""Every method on every log with true relations, beside the published figures; what the loop closing did."""

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from experiments.common import ROOT, Options, code_state, data_folder, say
from experiments.tables import Table, provenance
from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.events import EventKind
from slammot_graph.core.results import ClosureAttempt, GraphEdge, RunResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.evaluation import ErrorStats, RelationScores, evaluate_relations, read_relations
from slammot_graph.logs import LaserLog
from slammot_graph.loop_closure import LoopCloser, Submap
from slammot_graph.methods import METHODS, Config

WRONG_M, WRONG_DEG = 0.5, 5.0
"""A closure farther than this from the trajectory, or from the truth, is wrong."""

QUICK_SCANS = 400
QUICK_METHODS = ("graph", "odometry", "kiss-icp")
NAME_ENDINGS = tuple(kind + packing for kind in (".clf", ".log") for packing in ("", ".bz2", ".gz"))

HESS, KUEMMERLE = "Hess et al., ICRA 2016", "Kuemmerle et al., Autonomous Robots 2009"
PUBLISHED: dict[str, tuple[tuple[str, str, str], ...]] = {
    "aces": (
        (f"Cartographer ({HESS})", ".0375 +- .0426", ".373 +- .469"),
        (f"Graph mapping ({KUEMMERLE})", ".044 +- .044", "-"),
        (f"GMapping ({KUEMMERLE})", ".060 +- .049", "-"),
    ),
    "intel": (
        (f"Cartographer ({HESS})", ".0229 +- .0239", ".453 +- 1.335"),
        (f"Graph mapping ({KUEMMERLE})", ".031 +- .026", "-"),
        (f"GMapping ({KUEMMERLE})", ".070 +- .083", "-"),
    ),
    "killian": (
        (f"Cartographer ({HESS})", ".0395 +- .0488", ".352 +- .353"),
        (f"Graph mapping ({KUEMMERLE})", ".050 +- .056", "-"),
        (f"GMapping ({KUEMMERLE})", ".122 +- .386", "-"),
    ),
    "csail": (
        (f"Cartographer ({HESS})", ".0319 +- .0363", ".369 +- .365"),
        (f"Graph mapping ({KUEMMERLE})", ".004 +- .009", "-"),
        (f"GMapping ({KUEMMERLE})", ".049 +- .049", "-"),
    ),
    "fr079": (
        (f"Cartographer ({HESS})", ".0452 +- .0354", ".538 +- .718"),
        (f"Graph mapping ({KUEMMERLE})", ".056 +- .042", "-"),
        (f"GMapping ({KUEMMERLE})", ".061 +- .044", "-"),
    ),
}
"""Published translation [m] and rotation [degrees] errors, by a word in the log's name."""

AfterConsider = Callable[[LoopCloser, Submap], tuple[ClosureAttempt, ...]]


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Options of the experiments on loop closure.

    Attributes
    ----------
    quick : bool
        A small part, to see that everything works; its figures say nothing.
    data : Path, optional
        Folder of the recorded logs; by default $SLAMMOT_DATA, else ../shared/data.
    output : Path, optional
        Markdown file to write; by default experiments/tables/<name>.md.
    """

    quick: bool = False
    data: Path | None = None
    output: Path | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class WatchedRun:
    """A run, and what it took.

    Attributes
    ----------
    result : RunResult
    closer : LoopCloser or None
    submaps : list of Submap
        All local maps that were finished, by number.
    cpu_s : float
        CPU time of the whole run, with the reading of the log and the final labels.
    closing_cpu_s : float
        Of it, in the loop closing.
    steps_cpu_s : float
        Of it, in the steps.
    longest_ms, longest_cpu_ms : float
        Of the steps, by the clock and of the CPU.
    """

    result: RunResult
    closer: LoopCloser | None
    submaps: list[Submap]
    cpu_s: float
    closing_cpu_s: float
    steps_cpu_s: float
    longest_ms: float
    longest_cpu_ms: float


def run_watched(
    log: LaserLog,
    method: str = "graph",
    *,
    max_scans: int | None = None,
    config: Config | None = None,
    after_consider: AfterConsider | None = None,
) -> WatchedRun:
    """Run a method over (the first scans of) a log with an eye on the loop closing.

    `after_consider`, if given, is called with each finished local map after the loop closing has looked at it;
    it returns what `LoopCloser.consider` does.
    """
    closing_cpu_s = 0.0
    consider = LoopCloser.consider
    submaps: list[Submap] = []

    def watched(closer: LoopCloser, submap: Submap) -> tuple[ClosureAttempt, ...]:
        nonlocal closing_cpu_s
        submaps.append(submap)
        start = time.process_time()
        attempts = consider(closer, submap)
        closing_cpu_s += time.process_time() - start
        if after_consider is not None:
            attempts += after_consider(closer, submap)
        return attempts

    run = Run(log, method, config=config)
    cpu_ms = []
    start = before = time.process_time()
    with patch.object(LoopCloser, "consider", watched):
        steps = iter(run)
        for n, _ in enumerate(steps, start=1):
            now = time.process_time()
            cpu_ms.append(1e3 * (now - before))
            before = now
            if n == max_scans:
                break
        steps.close()  # type: ignore[attr-defined]
    cpu_s = time.process_time() - start
    result = run.result()
    localizer: Any = getattr(run.pipeline, "localizer", None)
    return WatchedRun(
        result=result,
        closer=getattr(localizer, "closer", None),
        submaps=submaps,
        cpu_s=cpu_s,
        closing_cpu_s=closing_cpu_s,
        steps_cpu_s=1e-3 * sum(cpu_ms),
        longest_ms=float(result.stage_ms["step"].max()),
        longest_cpu_ms=max(cpu_ms),
    )


def closures_of(result: RunResult) -> list[GraphEdge]:
    """The closures that are in the graph at the end."""
    return [edge for edge in result.edges if edge.kind == "closure"]


def closure_errors(closures: Sequence[GraphEdge], nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances [m] and angles [degrees] between closures and what (m, 3) poses of the nodes say."""
    if not closures:
        return np.zeros(0), np.zeros(0)
    said = se2.between(nodes[[c.from_node for c in closures]], nodes[[c.to_node for c in closures]])
    errors = se2.between(np.array([c.T_from_to for c in closures]), said)
    return np.hypot(errors[:, 0], errors[:, 1]), np.degrees(np.abs(errors[:, 2]))


def is_wrong(distance_m: FloatArray, angle_deg: FloatArray) -> BoolArray:
    """Which closures lie too far off."""
    return np.asarray((distance_m > WRONG_M) | (angle_deg > WRONG_DEG))


def largest(values: FloatArray, n_decimals: int = 3) -> str:
    """The largest of some values as text, "-" of none."""
    return f"{values.max():.{n_decimals}f}" if len(values) else "-"


def count_events(result: RunResult, *kinds: EventKind) -> int:
    """How many of a run's events are of some kinds."""
    return sum(event.kind in kinds for event in result.events)


def logs_with_relations(options: LoopOptions) -> dict[str, tuple[Path, Path]]:
    """Find the logs with true relations beside them: name to paths of log and relations, by name."""
    folder = data_folder(options.data)
    found = {}
    for relations in sorted(folder.rglob("*.relations")):
        name = relations.name.removesuffix(".relations")
        logs = [relations.with_name(name + ending) for ending in NAME_ENDINGS]
        if log := next((path for path in logs if path.is_file()), None):
            found[name] = (log, relations)
    if not found:
        raise InputError(
            f"{folder}: no .clf or .log with a .relations beside it; set SLAMMOT_DATA or --data to where they are"
        )
    return found


def spread(stats: ErrorStats, n_decimals: int) -> str:
    """Mean and standard deviation as text."""
    return f"{stats.mean:.{n_decimals}f} +- {stats.std:.{n_decimals}f}" if stats.n else "-"


def write_report(
    name: str, options: LoopOptions, title: str, notes: Iterable[str], tables: Iterable[Table], more: str = ""
) -> None:
    """Write the Markdown file: title, notes, command and machine, tables. `more`: other words of the command."""
    output = options.output or ROOT / "experiments" / "tables" / f"{name}.md"
    command = f"python -m experiments.{name}{' --quick' if options.quick else ''}{more}"
    origin = provenance(name, Options(quick=options.quick, jobs=1))[1:]
    head = [f"# {title}", "", *notes, "", f"- Command: `{command}`", *origin, ""]
    output.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join(head) + "\n" + "\n\n".join(table.markdown() for table in tables) + "\n"
    output.write_text(text, encoding="utf-8")
    say(f"{name}: {output}")


def command_line(
    experiment: Callable[[Any], None], options: type[LoopOptions], argv: list[str] | None
) -> int:
    """Run an experiment from the command line; mistakes become one line and exit code 2."""
    code_state()  # of the code that is loaded now, which may change on disk while the experiment runs
    try:
        experiment(
            tyro.cli(
                options, args=argv, description=experiment.__doc__, config=(tyro.conf.FlagCreatePairsOff,)
            )
        )
    except SlammotError as error:
        say(str(error))
        return 2
    return 0


def experiment(options: LoopOptions) -> None:
    """Every method on every log with true relations, beside the published figures."""
    tables, notes = [], []
    for name, (path, relations_path) in logs_with_relations(options).items():
        log, relations = open_log(path), read_relations(relations_path)
        max_scans = QUICK_SCANS if options.quick else None
        error_rows, closing_rows = [], []
        for method in QUICK_METHODS if options.quick else _graph_first(METHODS):
            try:
                run = run_watched(log, method, max_scans=max_scans)
            except SlammotError as error:
                say(f"freiburg: {name}, {method} failed: {error}")
                error_rows.append([method, f"failed: {error}", *["-"] * 5])
                continue
            scores = evaluate_relations(run.result.stamps, run.result.T_map_base, relations)
            error_rows.append(_error_row(method, run, scores))
            say(f"freiburg: {name}, {' | '.join(error_rows[-1])}")
            if method == "graph":
                again = run_watched(log, method, max_scans=max_scans).result
                is_same = _is_same(run.result, again)
                notes.append(f"- {name}: {_account(run.result, log, max_scans)}; {_verdict(is_same)}")
                say(f"freiburg: {notes[-1]}")
            if run.closer is not None:
                closing_rows.append(_closing_row(method, run))
                say(f"freiburg: {name}, {' | '.join(closing_rows[-1])}")
        for word, rows in PUBLISHED.items():
            if word in name.lower():
                error_rows += [[source, t, r, "-", "-", "-", "-"] for source, t, r in rows]
        tables.append(Table(heading=f"{name}: errors", columns=ERROR_COLUMNS, rows=error_rows))
        tables.append(Table(heading=f"{name}: loop closing", columns=CLOSING_COLUMNS, rows=closing_rows))
    intro = (
        "Relations of Kuemmerle et al. 2009: translation and rotation errors, mean +- standard deviation over all"
        " relations. One set of parameters for all logs. CPU seconds of the whole run in one process, with the"
        " reading of the log and the final labels. A closure is wrong if it lies more than"
        f" {WRONG_M} m or {WRONG_DEG:g} degrees from the final trajectory. Steps by the clock suffer from what"
        " else runs on the machine; CPU ms do not."
    )
    write_report("freiburg", options, "The Freiburg benchmark", [intro, "", *notes], tables)


ERROR_COLUMNS = (
    "method",
    "translation [m]",
    "rotation [degrees]",
    "largest [m]",
    "relations used",
    "closures",
    "CPU [s]",
)
CLOSING_COLUMNS = (
    "method",
    "closures in the graph",
    "outlier",
    "refused or waiting",
    "farthest from the trajectory [m]",
    "[degrees]",
    "wrong",
    "CPU of loop closing [s]",
    "share of the run",
    "share of the steps",
    "longest step [ms]",
    "[CPU ms]",
)


def _graph_first(methods: Iterable[str]) -> list[str]:
    return sorted(methods, key=lambda method: method != "graph")


def _error_row(method: str, run: WatchedRun, scores: RelationScores) -> list[str]:
    return [
        method,
        spread(scores.translation_m, 4),
        spread(scores.rotation_deg, 3),
        f"{scores.translation_m.max:.3f}" if scores.translation_m.n else "-",
        f"{scores.translation_m.n} of {scores.n_relations}",
        str(len(closures_of(run.result))) if run.closer is not None else "-",
        f"{run.cpu_s:.1f}",
    ]


def _closing_row(method: str, run: WatchedRun) -> list[str]:
    result = run.result
    closures = closures_of(result)
    distance_m, angle_deg = closure_errors(closures, result.nodes)
    n_not = count_events(result, "closure refused", "closure waiting")
    return [
        method,
        str(len(closures)),
        str(count_events(result, "closure rejected")),
        str(n_not),
        largest(distance_m),
        largest(angle_deg, 2),
        str(int(is_wrong(distance_m, angle_deg).sum())),
        f"{run.closing_cpu_s:.2f}",
        f"{100 * run.closing_cpu_s / run.cpu_s:.1f}%",
        f"{100 * run.closing_cpu_s / run.steps_cpu_s:.1f}%",
        f"{run.longest_ms:.0f}",
        f"{run.longest_cpu_ms:.0f}",
    ]


def _is_same(a: RunResult, b: RunResult) -> bool:
    return a.T_map_base.tobytes() == b.T_map_base.tobytes() and a.is_moving.tobytes() == b.is_moving.tobytes()


def _verdict(is_same: bool) -> str:
    return "two runs of graph are " + ("equal bit by bit" if is_same else "**not equal**")


def _account(result: RunResult, log: LaserLog, max_scans: int | None) -> str:
    """What became of the scans."""
    n_expected = log.n_scans if max_scans is None else min(max_scans, log.n_scans)
    lost = count_events(result, "lost")
    return f"{len(result.stamps)} poses of {n_expected} scans, {result.n_skipped} unusable, {lost} times lost"


if __name__ == "__main__":
    sys.exit(command_line(experiment, LoopOptions, None))
