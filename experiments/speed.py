"""How fast it is, beside kiss-icp on the same scans; how a long run grows; how long a start takes.

`--gate` compares with the committed ratios and fails where one is too large (`make bench`), `--write-baseline` writes
them anew.

Over 400 lines because four measurements share their scans, their warm-up and one report.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from experiments.common import ROOT, Options, say
from experiments.tables import Table, number, write_tables
from slammot_graph import open_log
from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.scan import Scan
from slammot_graph.detection import _cluster_kernels, _kernels
from slammot_graph.mapping import _local_map_kernels
from slammot_graph.mapping import occupancy_grid as grid
from slammot_graph.methods import get_method
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.registration import _judge_kernels, _solve_kernels
from slammot_graph.run import make_pipeline
from slammot_graph.simulation import SCENARIOS, SimulatedLog, simulate
from slammot_graph.simulation.robot import simulate_odometry
from slammot_graph.study.processes import THREAD_VARIABLES

METHODS = ("graph", "graph-noloop", "icp", "docpfo", "kiss-icp", "kiss-icp-odometry")
REFERENCE = "kiss-icp-odometry"
STAGES = ("predict", "detect", "match", "graph", "map", "objects")

LASERS = {"lms200": "181 beams", "lowcost360": "360 beams", "utm30lx": "1,081 beams"}
SCENARIO, RATE_HZ = "office", 10.0
N_WARM = 40
"""Scans that each method sees beforehand, so that its kernels are compiled; and as many that are not counted."""

ONE_THREAD = dict.fromkeys(THREAD_VARIABLES, "1")

GATE_LASERS, GATE_SCANS, GATE_ROUNDS = ("lms200", "lowcost360", "utm30lx"), 700, 3
GATE_SLACK = 1.25
BASELINE = ROOT / "experiments" / "baselines" / "speed.json"

KERNELS = {
    _kernels: ("test_beams", "seen_through"),
    _cluster_kernels: ("group_moving",),
    _solve_kernels: ("match_point_to_line",),
    _judge_kernels: ("judge_match",),
    _local_map_kernels: ("estimate_normals", "insert_points"),
    grid: ("update_by_scan",),
}
"""Kernels of the step, by the module that looks them up."""

REPEATED = ("match_point_to_line",)
"""Called twice to see them in warm caches; they change nothing but their results."""

N_START = 60
"""By this scan of a start every kernel of the step has been needed."""


@dataclass(frozen=True, kw_only=True)
class SpeedOptions(Options):
    """Options of the speed experiment.

    Attributes
    ----------
    scans : int, optional
        Length of the long run; by default 100,000, or 2,000 in quick mode.
    gate : bool
        Only compare with the committed ratios; exit code 1 where one is too large.
    write_baseline : bool
        Only measure the ratios and commit them to the file.
    baseline : Path
        The file of the ratios.
    """

    scans: int | None = None
    gate: bool = False
    write_baseline: bool = False
    baseline: Path = BASELINE


# --- in a child process: what is measured ---------------------------------------------------------------------------


def measure_steps(source: str, n_scans: int, methods: list[str]) -> dict[str, Any]:
    """Run methods over the same scans, scan by scan in turn: median and 95th percentile [ms] of their stages.

    "paired": the median over the scans of a step's time over the reference's on the same scan.
    """
    scans = list(islice(_scans(source), n_scans))
    for method in methods:
        _warm_up(method, scans)
    pipelines = {method: make_pipeline(get_method(method).config) for method in methods}
    took: dict[str, list[Mapping[str, float]]] = {method: [] for method in methods}
    order = list(methods)
    for scan in scans:
        order = [*order[1:], order[0]]  # nobody always follows the same one
        for method in order:
            own = replace(scan)  # end points that another method has computed do not count
            took[method].append(pipelines[method].step(own).stage_ms)
    for pipeline in pipelines.values():
        pipeline.close()
    counted = slice(min(N_WARM, len(scans) // 2), None)
    step_ms = {method: np.array([stages["step"] for stages in took[method][counted]]) for method in methods}
    return {
        "n_scans": len(scans),
        "ms": {method: _stage_statistics(took[method][counted]) for method in methods},
        "paired": {method: float(np.median(step_ms[method] / step_ms[REFERENCE])) for method in methods},
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def measure_kernels(source: str, n_scans: int) -> dict[str, Any]:
    """Time of `graph`'s kernels within its steps, medians over the scans, and how much work they do [us].

    "again": the same call once more at once, when all that it touches is in the caches.
    """
    scans = list(islice(_scans(source), n_scans))
    _warm_up("graph", scans)
    in_step: dict[str, float] = {}
    again: dict[str, float] = {}

    def timed(name: str, kernel: Callable[..., Any], *, repeat: bool) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            start = time.perf_counter()
            result = kernel(*arguments)
            in_step[name] = in_step.get(name, 0.0) + 1e6 * (time.perf_counter() - start)
            if repeat:
                start = time.perf_counter()
                kernel(*arguments)
                again[name] = again.get(name, 0.0) + 1e6 * (time.perf_counter() - start)
            return result

        return call

    rows: list[dict[str, float]] = []
    with ExitStack() as patches:
        for module, names in KERNELS.items():
            for name in names:
                kernel = getattr(module, name)
                wrapped = timed(name, kernel, repeat=name in REPEATED)
                patches.enter_context(patch.object(module, name, wrapped))
        config = get_method("graph").config
        assert isinstance(config, PipelineConfig)
        pipeline = Pipeline(config)
        tested = pipeline.detector.grid
        assert tested is not None
        for scan in scans:
            in_step.clear()
            again.clear()
            step = pipeline.step(replace(scan))
            n_points = int(np.count_nonzero(step.is_valid & ~step.is_moving))
            touched = int(np.count_nonzero(tested.stamp == scan.index))
            rows.append(
                {
                    "step": 1e3 * step.stage_ms["step"] - sum(again.values()),
                    **in_step,
                    **{f"{name} again": us for name, us in again.items()},
                    "evaluations": 0.0 if step.match is None else n_points * (step.match.n_iterations + 1.0),
                    "cells": float(touched),
                }
            )
        pipeline.close()
    counted = rows[min(N_WARM, len(rows) // 2) :]
    measured = dict.fromkeys(name for row in counted for name in row)
    us = {name: float(np.median([row.get(name, 0.0) for row in counted])) for name in measured}
    source_mb = np.ones(1 << 23)
    target_mb = np.empty_like(source_mb)
    copies = []
    for _ in range(5):
        start = time.perf_counter()
        np.copyto(target_mb, source_mb)
        copies.append(time.perf_counter() - start)
    return {"n_scans": len(scans), "us": us, "copy_gb_s": 2 * source_mb.nbytes / min(copies) / 1e9}


def measure_growth(n_scans: int) -> dict[str, Any]:
    """Run `graph` over a long drive to and fro in one building; time and memory by tenths of it."""
    scans = _endless(simulate(SCENARIO, seed=0, rate_hz=RATE_HZ), n_scans)
    first = list(islice(_scans("lms200"), 2 * N_WARM))
    _warm_up("graph", first)
    pipeline = make_pipeline(get_method("graph").config)
    step_ms, resident_mb = np.zeros(n_scans), np.zeros(10)
    n_nodes = np.zeros(10, dtype=np.int64)
    start = time.perf_counter()
    for scan in scans:
        step_ms[scan.index] = pipeline.step(scan).stage_ms["step"]
        tenth = 10 * (scan.index + 1) // n_scans
        if tenth and 10 * scan.index // n_scans < tenth:
            resident_mb[tenth - 1] = _resident_mb()
            n_nodes[tenth - 1] = len(pipeline.nodes_and_edges()[0])
    seconds = time.perf_counter() - start
    tenths = np.array_split(step_ms, 10)
    _, edges = pipeline.nodes_and_edges()
    pipeline.close()
    return {
        "n_scans": n_scans,
        "seconds": seconds,
        "median_ms": [float(np.median(t)) for t in tenths],
        "p95_ms": [float(np.percentile(t, 95)) for t in tenths],
        "longest_ms": [float(t.max()) for t in tenths],
        "resident_mb": resident_mb.tolist(),
        "n_nodes": n_nodes.tolist(),
        "n_closures": sum(edge.kind == "closure" for edge in edges),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _scans(source: str) -> Iterator[Scan]:
    if source in LASERS:
        return iter(simulate(SCENARIO, seed=0, laser=source, rate_hz=RATE_HZ))
    return iter(open_log(Path(source)))


def _warm_up(method: str, scans: list[Scan]) -> None:
    pipeline = make_pipeline(get_method(method).config)
    for scan in scans[: 2 * N_WARM]:
        pipeline.step(replace(scan))
    pipeline.close()


def _stage_statistics(took: list[Mapping[str, float]]) -> dict[str, list[float]]:
    names = dict.fromkeys(name for stages in took for name in stages)
    values = {name: [stages.get(name, 0.0) for stages in took] for name in names}
    return {name: [float(np.median(v)), float(np.percentile(v, 95))] for name, v in values.items()}


def _endless(log: SimulatedLog, n_scans: int) -> Iterator[Scan]:
    """Drive a short log to and fro until there are enough scans.

    Of the log the poses and ranges are taken again, backwards on every second pass; so the robot never jumps, and
    a scan looks the same where it comes by again, but the odometry over the whole drive is drawn anew and drifts on.
    """
    n = log.n_scans
    there_and_back = np.concatenate([np.arange(n), np.arange(n - 2, 0, -1)])
    which = there_and_back[np.arange(n_scans) % len(there_and_back)]
    rng = np.random.default_rng(1)
    T_odom_base, _ = simulate_odometry(log.T_world_base[which], SCENARIOS[SCENARIO].odometry, rng)
    for k, row in enumerate(which):
        yield Scan(
            index=k,
            stamp=k / RATE_HZ,
            ranges=log.ranges[row].copy(),  # as a reader gives it, so that memory counts
            laser=log.laser,
            T_odom_base=T_odom_base[k],
        )


def _resident_mb() -> float:
    path = Path("/proc/self/statm")
    if not path.exists():
        return float("nan")
    return int(path.read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 2**20


# --- in the parent --------------------------------------------------------------------------------------------------


def in_child(function: Callable[..., Any], *arguments: object, environment: dict[str, str]) -> Any:
    """Call a function of this module in a process of its own, where the environment can set the threads."""
    code = (
        "import json, sys; from experiments import speed;"
        f"print(json.dumps(speed.{function.__name__}(*json.loads(sys.argv[1]))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(arguments, default=str)],
        cwd=ROOT,
        env=_environment(environment),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise InputError(f"{function.__name__} failed with exit code {done.returncode}; its words are above")
    return json.loads(done.stdout.splitlines()[-1])


def measure_start(folder: Path, environment: dict[str, str]) -> tuple[float, float]:
    """Seconds from the command to the first scan's result, and to that of scan `N_START`."""
    path = folder / "start.npz"
    if not path.exists():
        log = simulate(SCENARIO, seed=0, rate_hz=RATE_HZ)
        arrays = {
            key: value[: N_START + 1] if np.ndim(value) and len(value) == log.n_scans else value
            for key, value in log.arrays().items()
        }
        with path.open("wb") as file:
            np.savez(file, **arrays)
    code = (
        "import os, sys; from slammot_graph import Run, open_log\n"
        "for n, _ in enumerate(Run(open_log(sys.argv[1])), start=1):\n"
        f"    if n in (1, {N_START}): print(n, flush=True)\n"
        f"    if n == {N_START}: os._exit(0)\n"
    )
    start = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)],
        env=_environment(environment),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdout is not None
        times = [time.perf_counter() - start for _ in child.stdout]
    if len(times) != 2:
        raise InputError("the start failed; its words are above")
    return times[0], times[1]


def _environment(more: dict[str, str]) -> dict[str, str]:
    return {**{key: value for key, value in os.environ.items() if key not in ONE_THREAD}, **more}


def _sources(options: SpeedOptions) -> dict[str, tuple[str, int]]:
    """What is measured: heading to source and number of scans."""
    n_scans = 120 if options.quick else 2000
    lasers = ("lms200",) if options.quick else ("lowcost360", "utm30lx")
    sources = {f"{SCENARIO}, {LASERS[laser]}": (laser, n_scans) for laser in lasers}
    if options.quick:
        return sources
    try:
        return {"intel": (str(options.recorded("intel.clf.bz2")), 5000), **sources}
    except InputError as error:
        say(f"speed: {error}; {SCENARIO} with the same kind of laser in its place")
        return {f"{SCENARIO}, {LASERS['lms200']}": ("lms200", n_scans), **sources}


def _step_table(heading: str, measured: dict[str, Any]) -> Table:
    reference = measured["ms"][REFERENCE]["step"]
    rows = []
    for method, stages in measured["ms"].items():
        median, p95 = stages["step"]
        rows.append(
            [
                method,
                f"{median / reference[0]:.2f}",
                f"{p95 / reference[1]:.2f}",
                f"{median:.3f}",
                f"{p95:.3f}",
                *("{:.3f} / {:.3f}".format(*stages[s]) if s in stages else "-" for s in STAGES),
            ]
        )
    columns = (
        "method",
        f"step over {REFERENCE}'s, medians",
        "95th percentiles",
        "step, median [ms]",
        "95th percentile [ms]",
        *(f"{stage} [ms]" for stage in STAGES),
    )
    return Table(heading=heading, columns=columns, rows=rows)


def _kernel_table(heading: str, measured: dict[str, Any]) -> Table:
    us = measured["us"]
    kernels = [name for names in KERNELS.values() for name in names if name in us]
    in_kernels = sum(us[name] for name in kernels)
    evaluations, cells = max(us["evaluations"], 1.0), max(us["cells"], 1.0)
    # each cell is read and written, its log odds and its stamp of 4 bytes each
    limit_us = 16e-3 * cells / measured["copy_gb_s"]
    rows = [[name, f"{us[name]:.1f}", f"{100 * us[name] / us['step']:.0f}%", "", ""] for name in kernels]
    for row in rows:
        if row[0] == "match_point_to_line":
            warm = us["match_point_to_line again"]
            row[3] = f"{evaluations:,.0f} point-to-line distances"
            row[4] = (
                f"{1e3 * us[row[0]] / evaluations:.1f} ns each; {1e3 * warm / evaluations:.1f} in warm caches"
            )
        elif row[0] == "update_by_scan":
            row[3] = f"{cells:,.0f} cells"
            row[4] = f"{1e3 * us[row[0]] / cells:.1f} ns each; {limit_us:.1f} us at the memory's speed"
    rows.append(
        [
            "all else: Python, numpy, gtsam",
            f"{us['step'] - in_kernels:.1f}",
            f"{100 * (1 - in_kernels / us['step']):.0f}%",
            "",
            "",
        ]
    )
    columns = ("kernel", "in a step, median [us]", "share", "work", "distance to the limit")
    return Table(heading=heading, columns=columns, rows=rows)


def _growth_table(measured: dict[str, Any]) -> Table:
    rows = [
        [
            f"{k + 1}",
            str(measured["n_nodes"][k]),
            f"{measured['median_ms'][k] / measured['median_ms'][0]:.2f}",
            f"{measured['median_ms'][k]:.3f}",
            f"{measured['p95_ms'][k]:.2f}",
            f"{measured['longest_ms'][k]:.0f}",
            number(measured["resident_mb"][k], 0),
        ]
        for k in range(10)
    ]
    columns = (
        "tenth of the run",
        "nodes at its end",
        "step over the first tenth's",
        "step, median [ms]",
        "95th percentile [ms]",
        "longest [ms]",
        "resident memory at its end [MB]",
    )
    heading = (
        f"A long run: {measured['n_scans']:,} scans, {measured['n_closures']} closures,"
        f" {measured['seconds']:.0f} s, peak memory {measured['peak_mb']:.0f} MB"
    )
    return Table(heading=heading, columns=columns, rows=rows)


def _start_table(quick: bool) -> Table:
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "cache").mkdir()
        caches = {"cold": {"NUMBA_CACHE_DIR": str(folder / "cache")}}
        caches["warm"] = caches["cold"]
        if quick:
            caches = {"warm": {}}
            measure_start(folder, {})
        for name, environment in caches.items():
            first_s, all_s = measure_start(folder, environment)
            rows.append([name, f"{first_s:.1f}", f"{all_s:.1f}"])
    columns = ("kernel cache", "to the first scan's result [s]", f"to scan {N_START}'s [s]")
    return Table(heading="Start, from the command on", columns=columns, rows=rows)


def experiment(options: SpeedOptions) -> None:
    """Time of a step beside kiss-icp's on the same scans, growth of a long run, time of a start."""
    tables = []
    peaks = []
    for heading, (source, n_scans) in _sources(options).items():
        threads = {"one thread": ONE_THREAD, "default threads": {}}
        for name, environment in list(threads.items())[: 1 if options.quick else 2]:
            measured = in_child(measure_steps, source, n_scans, list(METHODS), environment=environment)
            title = f"{heading}, {measured['n_scans']:,} scans, {name}"
            tables.append(_step_table(title, measured))
            peaks.append(f"{title}: {measured['peak_mb']:.0f} MB")
            ratio = measured["ms"]["graph"]["step"][0] / measured["ms"][REFERENCE]["step"][0]
            say(f"speed: {title}: graph takes {ratio:.2f} times as long as {REFERENCE}")
    for heading, (source, n_scans) in _sources(options).items():
        measured = in_child(measure_kernels, source, min(n_scans, 3000), environment=ONE_THREAD)
        title = f"Where the time goes: {heading}, {measured['n_scans']:,} scans"
        tables.append(_kernel_table(title, measured))
    n_long = options.scans or (2000 if options.quick else 100_000)
    tables.append(_growth_table(in_child(measure_growth, n_long, environment=ONE_THREAD)))
    tables.append(_start_table(options.quick))
    intro = (
        "Wall-clock time of `Pipeline.step`; for kiss-icp of its `register_frame` alone, at its best 2D setting. All"
        " methods see the same scans in one process, each scan by every method before the next one, in turns, so that"
        " whatever else the machine does hits all alike: the ratios say more than the milliseconds. Stages: median /"
        " 95th percentile. The first scans are not counted."
    )
    growth = (
        "The long run drives one lap of the simulated office to and fro, its ranges taken again, its odometry drawn"
        f" anew over the whole distance{'' if options.scans is None else f'; its length from --scans {options.scans}'}."
        " Where the time goes: kernels within a step, medians, so that those of a keyframe (normals, insertion) show 0;"
        " the memory's speed is that of copying 64 MB."
        " Peak memory of all methods together in one process: " + "; ".join(peaks) + "."
    )
    write_tables("speed", "Speed", [intro, "", growth], tables, options)


# --- the gate -------------------------------------------------------------------------------------------------------


def measure_ratios() -> dict[str, float]:
    """Step of `graph` over kiss-icp's on the same simulated scans, one thread; the median of a few rounds."""
    ratios = {}
    for laser in GATE_LASERS:
        rounds = []
        for _ in range(GATE_ROUNDS):
            measured = in_child(
                measure_steps, laser, GATE_SCANS, ["graph", REFERENCE], environment=ONE_THREAD
            )
            rounds.append(measured["paired"]["graph"])
        ratios[laser] = round(float(np.median(rounds)), 3)
    return ratios


def too_slow(ratios: dict[str, float], baseline: dict[str, float]) -> list[str]:
    """Say which ratios are too far over the baseline's."""
    return [
        f"{laser}: graph takes {ratios[laser]:.2f} times as long as {REFERENCE},"
        f" {100 * (ratios[laser] / was - 1):.0f}% over the baseline {was:.2f}"
        for laser, was in baseline.items()
        if laser in ratios and ratios[laser] > GATE_SLACK * was
    ]


def gate(path: Path) -> int:
    """Compare with the committed ratios; the exit code."""
    try:
        baseline = {
            str(k): float(v) for k, v in json.loads(path.read_text(encoding="utf-8"))["ratios"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: no ratios to compare with ({type(error).__name__}); write them with --write-baseline"
        ) from None
    ratios = measure_ratios()
    for laser, was in baseline.items():
        say(
            f"speed: {laser}: graph over {REFERENCE} {ratios.get(laser, float('nan')):.3f}, baseline {was:.3f}"
        )
    failures = too_slow(ratios, baseline)
    if failures:
        say("speed: FAILED: " + "; ".join(failures))
    return int(bool(failures))


def write_baseline(path: Path) -> None:
    """Measure the ratios and write them."""
    ratios = measure_ratios()
    note = (
        f"step of graph over {REFERENCE}'s, median over scans; python -m experiments.speed --write-baseline"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"note": note, "ratios": ratios}, indent=2) + "\n", encoding="utf-8")
    say(f"speed: {path}: {ratios}")


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; mistakes become one line and exit code 2."""
    try:
        options = tyro.cli(
            SpeedOptions,
            args=argv,
            description=(__doc__ or "").rpartition("\n\n")[0],
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        if options.gate:
            return gate(options.baseline)
        if options.write_baseline:
            write_baseline(options.baseline)
        else:
            experiment(options)
    except SlammotError as error:
        say(str(error))
        return 2
    except KeyboardInterrupt:
        say("interrupted")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
