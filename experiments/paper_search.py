"""A search for the best setting of the paper's methods: what the paper leaves open, on half of the worlds and seeds."""

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, number, write_tables
from slammot_graph import Run
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.evaluation import absolute_error
from slammot_graph.localization.config import ScanToScanConfig, StepConfig
from slammot_graph.methods import get_method
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.simulation import SimulatedLog, simulate

SEARCHED_ON = (("two-walkers", 2), ("lab", 4), ("office", 4), ("corridor", 3))
"""Scenario and number of people; hall, crowd and building are left for `paper_judge`."""
SEARCH_SEEDS = (0, 2, 4)
NOISES = (1.0, 3.0)
RATE_HZ = 5.0
METHODS = ("icp", "docpfo")
MAX_LOSS = 1.05
"""A setting of the detector may make the trajectory's error so many times greater, and no more."""
N_ROUNDS = 2

Setting = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Knob:
    """A value that is searched: what it is called, what is tried, and whether it is the detector's."""

    name: str
    title: str
    values: tuple[Any, ...]
    is_detectors: bool = False


KNOBS = (
    Knob(
        name="kept_share",
        title="rejection: share of the pairs that is kept",
        values=(1.0, 0.9, 0.8, 0.7, 0.6),
    ),
    Knob(
        name="max_gap_m",
        title="interpolation between points up to [m] apart",
        values=(None, 0.1, 0.3, 1.0, 2.0),
    ),
    Knob(name="max_distance_m", title="rejection: distance of a pair [m]", values=(0.2, 0.3, 0.5, 1.0, 2.0)),
    Knob(name="distance_m", title="step: distance [m]", values=(0.1, 0.25, 0.5, 0.75, 1.0)),
    Knob(name="turn_rad", title="step: turn [rad]", values=(0.1, 0.25, 0.5, 1.0, math.inf)),
    Knob(name="time_s", title="step: time [s]", values=(0.5, 1.0, 2.0, math.inf)),
    Knob(name="maps_between", title="scans between go into the map", values=(True, False)),
    Knob(name="tau_m", title="tau [m]", values=(1e-3, 1e-4, 1e-5, 1e-6)),
    Knob(name="max_iterations", title="iteration limit", values=(10, 30, 100, 300)),
    Knob(name="resolution_m", title="grid resolution [m]", values=(0.05, 0.1, 0.15, 0.2), is_detectors=True),
    Knob(name="n_sigma", title="n_sigma", values=(1.0, 1.5, 2.0, 2.448, 3.0), is_detectors=True),
    Knob(name="min_points", title="MINNUMBER", values=(2, 3, 5), is_detectors=True),
    Knob(name="max_range_m", title="MAX RANGE [m]", values=(0.8, 1.0, 1.5, 2.5), is_detectors=True),
)
START: Setting = {
    "distance_m": 0.5,
    "turn_rad": 0.5,
    "time_s": math.inf,
    "maps_between": True,
    "max_distance_m": 0.5,
    "kept_share": 1.0,
    "max_gap_m": None,
    "tau_m": 1e-5,
    "max_iterations": 100,
    "resolution_m": 0.05,
    "n_sigma": 2.448,
    "min_points": 2,
    "max_range_m": 1.5,
}
"""The setting of `docpfo-every-scan`, at a step of half a metre."""


def setting_of(config: PipelineConfig) -> Setting:
    """Give the searched values of a paper's method."""
    localizer, detector = config.localizer, config.detector
    assert isinstance(localizer, ScanToScanConfig)
    assert isinstance(localizer.step, StepConfig)
    assert isinstance(detector, EllipseDetectorConfig)
    parts = (localizer.step, localizer.point_to_point)
    values = {k.name: getattr(part, k.name) for k, part in product(KNOBS, parts) if hasattr(part, k.name)}
    return {
        **values,
        "resolution_m": config.grid.resolution_m,
        "n_sigma": detector.ellipse_test.n_sigma,
        "min_points": detector.clusters.min_points,
        "max_range_m": detector.clusters.max_x_range_m,
    }


def configured(method: str, setting: Mapping[str, Any]) -> PipelineConfig:
    """Give the configuration of icp or docpfo at a setting."""
    config = get_method(f"{method}-every-scan").config
    assert isinstance(config, PipelineConfig)
    assert isinstance(config.localizer, ScanToScanConfig)
    names = ("distance_m", "turn_rad", "time_s", "maps_between")
    step = StepConfig(**{name: setting[name] for name in names})
    of_match = ("max_distance_m", "kept_share", "max_gap_m", "tau_m", "max_iterations")
    match = replace(config.localizer.point_to_point, **{name: setting[name] for name in of_match})
    config = replace(
        config,
        localizer=ScanToScanConfig(step=step, point_to_point=match),
        grid=replace(config.grid, resolution_m=setting["resolution_m"]),
    )
    detector = config.detector
    if isinstance(detector, EllipseDetectorConfig):
        reach_m = setting["max_range_m"]
        clusters = replace(
            detector.clusters,
            min_points=setting["min_points"],
            max_x_range_m=reach_m,
            max_y_range_m=reach_m,
        )
        test = replace(detector.ellipse_test, n_sigma=setting["n_sigma"])
        config = replace(config, detector=replace(detector, ellipse_test=test, clusters=clusters))
    return config


@lru_cache(maxsize=64)
def _log(scenario: str, people: int, noise: float, seed: int) -> SimulatedLog:
    return simulate(scenario, seed=seed, n_people=people, noise_scale=noise, rate_hz=RATE_HZ)


def search_cell(scenario: str, people: int, noise: float, seed: int, method: str, setting: Setting) -> Scores:
    """Run icp or docpfo at a setting over one log."""
    log = _log(scenario, people, noise, seed)
    result = Run(log, config=configured(method, setting)).complete()
    wheels = absolute_error(log.T_odom_base, log.T_world_base).translation_m.rmse
    ate = absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse
    points = measures.point_scores(result.is_moving, log, result.is_valid)
    return {"ratio": ate / wheels, "iou": points["iou"]}


class Search:
    """Settings tried so far, with their scores."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.logs = list(product(SEARCHED_ON, NOISES, SEARCH_SEEDS))
        if options.quick:
            self.logs = [(("one-walker", 1), 1.0, 0)]
        self.scores: dict[str, Scores] = {}

    def run(self, settings: Iterable[tuple[str, Setting]]) -> None:
        """Try methods at settings; what was tried already is not run again."""
        cells = {}
        for method, setting in settings:
            for (scenario, people), noise, seed in self.logs:
                key = f"{scenario} {people} {noise:g} {seed} {method} {words(method, setting)}"
                if key not in self.scores:
                    cells[key] = {
                        "scenario": scenario,
                        "people": people,
                        "noise": noise,
                        "seed": seed,
                        "method": method,
                        "setting": setting,
                    }
        if cells:
            self.scores |= run_cells("paper_search", search_cell, cells, self.options)
            self.options = replace(self.options, fresh=False)  # a later stage keeps what an earlier one wrote

    def mean(self, method: str, setting: Setting, name: str) -> float:
        """Geometric mean of the ratio, or mean of the IoU, over the logs."""
        tail = f" {method} {words(method, setting)}"
        found = [score[name] for key, score in self.scores.items() if key.endswith(tail)]
        return float(np.exp(np.mean(np.log(found))) if name == "ratio" else np.mean(found))

    def error(self, setting: Setting) -> float:
        """Geometric mean of both methods' ratios."""
        return math.sqrt(math.prod(self.mean(method, setting, "ratio") for method in METHODS))

    def best(self, knob: Knob, setting: Setting) -> Any:
        """Give the best value of a knob, the others as in the setting; ties go to the one that stands."""
        options = {value: {**setting, knob.name: value} for value in knob.values}
        methods = METHODS[1:] if knob.is_detectors else METHODS
        self.run((method, tried) for tried in options.values() for method in methods)
        if not knob.is_detectors:
            return min(
                options, key=lambda value: (round(self.error(options[value]), 4), value != setting[knob.name])
            )
        least = self.mean("docpfo", setting, "ratio")
        allowed = [
            value for value in options if self.mean("docpfo", options[value], "ratio") <= MAX_LOSS * least
        ]
        return max(allowed, key=lambda value: self.mean("docpfo", options[value], "iou"))


def words(method: str, setting: Setting) -> str:
    """Values of a setting that a method has."""
    own = [knob for knob in KNOBS if method == "docpfo" or not knob.is_detectors]
    return " ".join(f"{knob.name}={setting[knob.name]}" for knob in own)


def found_setting(search: Search) -> tuple[Setting, dict[str, Setting]]:
    """Choose one knob after the other, in several rounds; also give where each knob stood in the last of them."""
    setting = dict(START)
    stood: dict[str, Setting] = {}
    for _ in range(1 if search.options.quick else N_ROUNDS):
        for knob in KNOBS[:1] if search.options.quick else KNOBS:
            stood[knob.name] = dict(setting)
            setting[knob.name] = search.best(knob, setting)
    return setting, stood


def experiment(options: Options) -> None:
    """Search the settings of icp and docpfo on half of the worlds and seeds."""
    search = Search(options)
    found, stood = found_setting(search)
    config = get_method("docpfo").config
    assert isinstance(config, PipelineConfig)
    used = setting_of(config)
    knobs = KNOBS[:1] if options.quick else KNOBS
    search.run((m, s) for m, s in product(METHODS, (START, found, used)))
    effects = [
        _effect(search, knob, value, stood[knob.name], used) for knob in knobs for value in knob.values
    ]
    columns = ["setting", "value", "error of icp", "error of docpfo", "point IoU of docpfo"]
    summary = [
        [
            name,
            *(number(search.mean(m, setting, "ratio")) for m in METHODS),
            number(search.mean("docpfo", setting, "iou")),
        ]
        for name, setting in (("start of the search", START), ("found", found), ("registry", used))
    ]
    tables = [
        Table(heading="Settings", columns=["setting", *columns[2:]], rows=summary),
        Table(heading="Effect of each value in the last round", columns=columns, rows=effects),
    ]
    notes = [
        "What the paper leaves open, searched value by value in the order of the table, in"
        f" {N_ROUNDS} rounds, from half a metre a step and the other values of `docpfo-every-scan`. Searched on"
        f" {', '.join(f'{name} ({n} people)' for name, n in SEARCHED_ON)} with odometry noise x"
        f" {' and x '.join(f'{noise:g}' for noise in NOISES)}, seeds {', '.join(map(str, SEARCH_SEEDS))},"
        f" {RATE_HZ:g} scans a second. Error: ATE over that of the wheels, geometric mean. Values of the step and of"
        " the match are chosen by the error of both methods; those of the test by the point IoU, where the error grows"
        f" by no more than {MAX_LOSS - 1.0:.0%}. Below, each value is tried with those above it as found, and those"
        " below it as the round before left them. Bold: used in the registry. Judged on other worlds and seeds:"
        " `paper_judge.md`.",
    ]
    write_tables("paper_search", "Settings of the paper's methods", notes, tables, options)


def _effect(search: Search, knob: Knob, value: Any, others: Setting, used: Setting) -> list[str]:
    tried = {**others, knob.name: value}
    text = f"{value:g}" if type(value) in (int, float) else {True: "yes", False: "no"}.get(value, "none")
    icp = "" if knob.is_detectors else number(search.mean("icp", tried, "ratio"))
    docpfo = [number(search.mean("docpfo", tried, name)) for name in ("ratio", "iou")]
    return [knob.title, f"**{text}**" if value == used[knob.name] else text, icp, *docpfo]


if __name__ == "__main__":
    sys.exit(main(experiment))
