"""From the paper's method to ours, one change a preset: what each brings."""

import sys
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from experiments import measures, recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, median_interval, p_text, paired_p, write_tables
from slammot_graph import Run
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.evaluation import evaluate_relations
from slammot_graph.localization.config import ScanToLocalMapConfig, ScanToMapConfig, ScanToScanConfig
from slammot_graph.methods import get_method
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig
from slammot_graph.simulation import SimulatedLog

SCENARIOS = {"lab": 20, "office": 10, "hall": 10}
"""With the number of seeds."""
LOGS = {"intel": 5, "fr079": 5}
"""Recorded logs, of which a part with people injected is run, with the number of seeds."""
RATE_HZ = 5.0
N_SCANS, QUICK_SCANS, N_PEOPLE = 1000, 150, 6
MAX_DURATION_S = 10.0
COLUMNS = (
    ("ate_m", "ATE [m]", 4),
    ("iou", "point IoU", 3),
    ("ghosts_per_m2", "ghost cells/m^2", 3),
    ("lost_per_m2", "lost wall cells/m^2", 3),
    ("step_ms", "ms/scan", 2),
)
NO_KERNEL = PointToLineConfig(kernel_scale_m=10.0, fragile_pairs=0.0)
"""A residual of the local map's reach keeps all of its weight."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A name, and what it changes of the preset before."""

    name: str
    change: str
    config: PipelineConfig


def _config(method: str) -> PipelineConfig:
    config = get_method(method).config
    assert isinstance(config, PipelineConfig)
    return config


def presets() -> tuple[Preset, ...]:
    """Give all presets, the paper's method first, ours last."""
    paper, ours = _config("docpfo"), _config("graph")
    assert isinstance(paper.localizer, ScanToScanConfig)
    assert isinstance(paper.detector, EllipseDetectorConfig)
    assert isinstance(ours.localizer, ScanToMapConfig)
    assert isinstance(ours.detector, EllipseDetectorConfig)
    to_points: PointToPointConfig = replace(paper.localizer.point_to_point, max_gap_m=None)
    onto_map = ScanToLocalMapConfig(step=paper.localizer.step, matcher=to_points)
    found = [Preset(name="docpfo", change="the paper's method", config=paper)]

    def add(name: str, change: str, config: PipelineConfig) -> PipelineConfig:
        found.append(Preset(name=name, change=change, config=config))
        return config

    config = add(
        "local map",
        "matched onto the points of the latest 15 keyframes in place of one scan; 5 cm apart they are not interpolated",
        replace(paper, localizer=onto_map),
    )
    to_lines = replace(onto_map, matcher=NO_KERNEL)
    config = add(
        "point to line", "points pair with the lines of the local map", replace(config, localizer=to_lines)
    )
    to_lines = replace(to_lines, step=None)
    config = add("every scan", "a cycle at each scan", replace(config, localizer=to_lines))
    to_lines = replace(to_lines, matcher=PointToLineConfig())
    config = add("robust kernel", "Geman-McClure", replace(config, localizer=to_lines))
    config = add(
        "static-only map",
        "points that move occupy no cells",
        replace(config, grid=replace(config.grid, occupy_with_moving=False)),
    )
    config = add(
        "marginal covariance",
        "the test takes the covariance relative to the local map in place of R_r",
        replace(config, detector=replace(paper.detector, test_covariance="relative")),
    )
    plain = replace(
        ours.detector,
        ellipse_test=paper.detector.ellipse_test,
        clusters=paper.detector.clusters,
        visibility_check=None,
        retest=None,
        hit_memory=None,
        backward_pass=False,
    )
    no_loops = replace(ours.localizer, close_loops=False)
    config = add(
        "pose graph",
        "matches and odometry as factors; odometry is learnt; the map is made of the nodes' scans, the test has a grid"
        " of its own that forgets",
        replace(ours, localizer=no_loops, detector=plain, tracker=paper.tracker),
    )
    config = add(
        "test at the match",
        "the test again at the matched pose, a margin of one cell, visibility check, wide subsets are split, a memory"
        " of hits",
        replace(config, detector=replace(ours.detector, backward_pass=False)),
    )
    config = add(
        "tracker",
        "the tracker joins legs, and knows where the laser looks: it tells the test where people are expected",
        replace(config, tracker=ours.tracker),
    )
    config = add("loop closure", "loops are closed", replace(config, localizer=ours.localizer))
    add(
        "backward pass",
        "labels are looked at again after the run: `graph`",
        replace(config, detector=ours.detector),
    )
    return tuple(found)


def cell(scenario: str, seed: int, preset: str) -> Scores:
    """Run one preset over one simulated log."""
    log = measures.simulated(scenario, seed, rate_hz=RATE_HZ)
    result = Run(log, config=_preset(preset)).complete()
    return {
        **measures.trajectory_scores(result, log.T_world_base),
        **measures.point_scores(result.is_moving, log, result.is_valid),
        **measures.map_scores(result, log, measures.without_people(scenario, seed, rate_hz=RATE_HZ)),
        "step_ms": measures.step_ms(result),
    }


def recorded_cell(log: str, reference: str, seed: int, n_scans: int, preset: str) -> Scores:
    """Run one preset over the first scans of a recorded log with people injected."""
    walkers = recorded.with_walkers(log, reference, N_PEOPLE, seed, n_scans)
    result = Run(walkers, config=_preset(preset)).complete()
    is_judged = result.is_valid & ~recorded.is_of_the_log(walkers, reference)
    relations = evaluate_relations(
        result.stamps, result.T_map_base, recorded.relations_of(log), max_duration_s=MAX_DURATION_S
    )
    return {
        "ate_m": relations.translation_m.mean,
        **measures.point_scores(result.is_moving, walkers, is_judged),
        **measures.map_scores(result, walkers, _without_people(walkers)),
        "step_ms": measures.step_ms(result),
    }


def _without_people(log: SimulatedLog) -> SimulatedLog:
    """Give the log without the beams that end on the people put in."""
    clean = copy(log)
    clean.ranges = np.where(log.is_moving, np.inf, log.ranges)
    return clean


def _preset(name: str) -> PipelineConfig:
    return next(preset.config for preset in presets() if preset.name == name)


def experiment(options: Options) -> None:
    """Each preset from docpfo to graph on simulated logs, and on parts of recorded ones with people injected."""
    names = [preset.name for preset in presets()]
    worlds = {"one-walker": 2} if options.quick else SCENARIOS
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    seeds = {name: range(options.seeds or n) for name, n in worlds.items()}
    cells = {
        f"{scenario} {seed} {preset}": {"scenario": scenario, "seed": seed, "preset": preset}
        for scenario in worlds
        for seed in seeds[scenario]
        for preset in names
    }
    scores = run_cells("ladder", cell, cells, options)
    tables = [_table(world, "ATE [m]", seeds[world], scores, world) for world in worlds]
    for log, n in () if options.quick else LOGS.items():
        path = str(options.recorded(f"{log}.clf.bz2"))
        reference = recorded.make_reference(log, options, n_scans)
        log_seeds = range(options.seeds or n)
        more = {
            f"{log} {n_scans} {seed} {preset}": {
                "log": path,
                "reference": reference,
                "seed": seed,
                "n_scans": n_scans,
                "preset": preset,
            }
            for seed in log_seeds
            for preset in names
        }
        found = run_cells("ladder_recorded", recorded_cell, more, replace(options, fresh=False))
        title = f"relations under {MAX_DURATION_S:g} s [m]"
        tables.append(_table(log, title, log_seeds, found, f"{log} {n_scans}"))
    changes = Table(
        heading="Presets",
        columns=["preset", "change"],
        rows=[[preset.name, preset.change] for preset in presets()],
    )
    notes = [
        "Each preset changes one thing of the preset above it; the last one is `graph`. Median [95% bootstrap interval]"
        f" over paired seeds: {', '.join(f'{name} {len(seeds[name])}' for name in worlds)}"
        + ("." if options.quick else f", {', '.join(f'{name} {n}' for name, n in LOGS.items())}.")
        + f" Simulated logs at {RATE_HZ:g} scans a second. Of the recorded logs the first {n_scans} scans, with"
        f" {N_PEOPLE} people put in: the error is the mean one of the true relations whose ends lie under"
        f" {MAX_DURATION_S:g} s apart, the map is compared with that of the scans without the people's beams at the"
        " reference trajectory, which is a run of `graph` over the clean log. p: against the preset above, paired"
        " Wilcoxon, two-sided, of the error. The marginal covariance is that of the front end, relative to the local"
        " map, which needs no graph."
    ]
    write_tables(
        "ladder", "From the paper's method to graph, one change a preset", notes, [changes, *tables], options
    )


def _table(world: str, error: str, seeds: Sequence[int], scores: Mapping[str, Scores], key: str) -> Table:
    rows = []
    before: list[float] | None = None
    for preset in presets():

        def column(name: str, preset: str = preset.name) -> list[float]:
            return [scores[f"{key} {seed} {preset}"][name] for seed in seeds]

        errors = column("ate_m")
        texts = [median_interval(column(name), digits) for name, _, digits in COLUMNS]
        rows.append([preset.name, *texts, "" if before is None else p_text(paired_p(errors, before))])
        before = errors
    columns = ["preset", error, *(title for _, title, _ in COLUMNS[1:]), "p"]
    return Table(heading=f"{world}, {len(seeds)} seeds", columns=columns, rows=rows)


if __name__ == "__main__":
    sys.exit(main(experiment))
