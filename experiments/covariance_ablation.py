"""Which covariance should the moving-point test be given? Over odometry noise, and over the distance driven."""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.common import Options, Scores, main, run_cells
from experiments.figures import panels, save
from experiments.measures import point_scores
from experiments.tables import Table, holm, median_interval, p_text, paired_p, write_tables
from slammot_graph import Run, get_method
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.ellipse_test import CommonModeConfig, EllipseTestConfig
from slammot_graph.evaluation import evaluate_points
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.pipeline import PipelineConfig
from slammot_graph.simulation import SimulatedLog, simulate

NOISE_SCENARIO, NOISES, FULL_SEEDS = "office", (0.5, 1.0, 2.0, 4.0), 20
PATH_SCENARIO, PATH_LAPS, PATH_RATE_HZ, PATH_SEEDS, PATH_BIN_M = "building", 3, 5.0, 6, 50.0
TUNED = ConstantNoise(x_std_m=0.02, y_std_m=0.02, theta_std_rad=0.01)
"""The best of the constants below, on seeds 100 to 102 of the office with its own noise."""
CONSTANTS = ((0.005, 0.0025), (0.01, 0.005), (0.02, 0.01), (0.04, 0.02), (0.1, 0.05))

COVARIANCES = {
    "paper": "the paper's constant R_r",
    "tuned": "a constant, tuned",
    "absolute": "absolute marginal",
    "relative": "marginal relative to the anchor (`graph`)",
    "common": "the same, as an error common to the scan",
}
FIGURES = ("iou", "precision", "recall")


def configured(covariance: str) -> PipelineConfig:
    """`graph-noloop` with one of the covariances in the test; closures would bound the absolute one."""
    config = get_method("graph-noloop").config
    assert isinstance(config, PipelineConfig)
    return replace(config, detector=_detector(covariance))


def _detector(covariance: str) -> EllipseDetectorConfig:
    if covariance == "paper":
        return EllipseDetectorConfig(test_covariance=ConstantNoise())
    if covariance == "tuned":
        return EllipseDetectorConfig(test_covariance=TUNED)
    if covariance == "common":
        return EllipseDetectorConfig(ellipse_test=EllipseTestConfig(common_mode=CommonModeConfig()))
    if covariance in ("absolute", "relative"):
        return EllipseDetectorConfig(test_covariance="absolute" if covariance == "absolute" else "relative")
    std_m, std_rad = (float(text) for text in covariance.split("/"))
    constant = ConstantNoise(x_std_m=std_m, y_std_m=std_m, theta_std_rad=std_rad)
    return EllipseDetectorConfig(test_covariance=constant)


def noise_cell(covariance: str, noise: float, seed: int) -> Scores:
    """Online labels of one run."""
    log = simulate(NOISE_SCENARIO, seed=seed, noise_scale=noise)
    result = Run(log, "graph-noloop", config=configured(covariance)).complete()
    return point_scores(result.is_moving_online, log, result.is_valid)


def path_cell(covariance: str, seed: int, n_laps: int) -> Scores:
    """Recall and precision of the online labels and size of the test's covariance, by distance driven."""
    log = simulate(PATH_SCENARIO, seed=seed, n_laps=n_laps, rate_hz=PATH_RATE_HZ)
    run = Run(log, "graph-noloop", config=configured(covariance))
    std_m = [float(np.sqrt(np.trace(step.cov_relative[:2, :2]))) for step in run]
    result = run.result()
    part = (_path_length_m(log) // PATH_BIN_M).astype(np.int64)
    scores: Scores = {"recall": [], "precision": [], "std_m": []}
    for k in range(int(part[-1])):  # the last one is not full
        points = evaluate_points(
            result.is_moving_online[part == k], log.is_moving[part == k], result.is_valid[part == k]
        )
        scores["recall"].append(points.recall)
        scores["precision"].append(points.precision)
        scores["std_m"].append(float(np.median(np.array(std_m)[part == k])))
    return scores


def _path_length_m(log: SimulatedLog) -> "np.ndarray":
    steps = np.hypot(*np.diff(log.T_world_base[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def experiment(options: Options) -> None:
    """The moving-point test with five covariances, over graded odometry noise and over the distance driven."""
    seeds = options.seed_range(FULL_SEEDS, quick=1)
    noises = NOISES[1:2] if options.quick else NOISES
    names = ("absolute", "relative") if options.quick else tuple(COVARIANCES)
    noise_cells = {
        f"{covariance} {noise:g} {seed}": {"covariance": covariance, "noise": noise, "seed": seed}
        for seed in seeds
        for noise in noises
        for covariance in names
    }
    tuning = range(100, 100 if options.quick else 103)
    constants = [f"{std_m}/{std_rad}" for std_m, std_rad in CONSTANTS]
    noise_cells |= {
        f"{constant} 1 {seed}": {"covariance": constant, "noise": 1.0, "seed": seed}
        for seed in tuning
        for constant in constants
    }
    by_noise = run_cells("covariance_ablation", noise_cell, noise_cells, options)
    n_laps = 1 if options.quick else PATH_LAPS
    path_seeds = range(1 if options.quick else PATH_SEEDS)
    path_cells = {
        f"{covariance} {n_laps} {seed}": {"covariance": covariance, "seed": seed, "n_laps": n_laps}
        for seed in path_seeds
        for covariance in names
        if covariance != "common"
    }
    by_path = run_cells("covariance_ablation_path", path_cell, path_cells, options)

    def column(covariance: str, noise: float, figure: str) -> list[float]:
        return [by_noise[f"{covariance} {noise:g} {seed}"][figure] for seed in seeds]

    tables = [_noise_table(noise, names, column) for noise in noises]
    if tuning:
        rows = [
            [f"{c} m / rad", *(median_interval([by_noise[f"{c} 1 {s}"][f] for s in tuning]) for f in FIGURES)]
            for c in constants
        ]
        tables.append(
            Table(heading="Tuning of the constant (seeds 100 to 102)", columns=["", *FIGURES], rows=rows)
        )
    of_path = {
        name: [by_path[f"{name} {n_laps} {seed}"] for seed in path_seeds]
        for name in names
        if name != "common"
    }
    tables.append(_path_table(of_path))
    _draw(of_path, options)
    notes = [
        f"Over noise: the {NOISE_SCENARIO} scenario, its odometry noise times the factor, {len(seeds)} paired seeds,"
        " online labels, without loop closure (which bounds the absolute marginal): median [95% bootstrap interval]."
        " p: paired Wilcoxon of the IoU against the relative marginal, Holm's correction within a table.",
        f"Over the distance: the {PATH_SCENARIO} scenario, {n_laps} laps, {len(path_seeds)} seeds. Figure:"
        " figures/covariance_over_path.png.",
    ]
    write_tables("covariance_ablation", "Covariances in the moving-point test", notes, tables, options)


def _noise_table(
    noise: float, names: tuple[str, ...], column: Callable[[str, float, str], list[float]]
) -> Table:
    p_values = holm(
        {
            name: paired_p(column(name, noise, "iou"), column("relative", noise, "iou"))
            for name in names
            if name != "relative"
        }
    )
    rows = [
        [
            COVARIANCES[name],
            *(median_interval(column(name, noise, figure)) for figure in FIGURES),
            "" if name == "relative" else p_text(p_values[name]),
        ]
        for name in names
    ]
    return Table(
        heading=f"Odometry noise x {noise:g}",
        columns=["covariance in the test", "IoU", "precision", "recall", "p"],
        rows=rows,
    )


def _path_table(of_path: dict[str, list[Scores]]) -> Table:
    rows = []
    for name, found in of_path.items():
        n_parts = min(len(score["recall"]) for score in found)
        for figure in ("recall", "std_m"):
            first = [float(np.mean(score[figure][:2])) for score in found]
            last = [float(np.mean(score[figure][n_parts - 2 : n_parts])) for score in found]
            lost = [b - a for a, b in zip(first, last, strict=True)]
            label = f"{COVARIANCES[name]}: {'recall' if figure == 'recall' else 'standard deviation [m]'}"
            rows.append([label, *(median_interval(values) for values in (first, last, lost))])
    distance = f"{PATH_BIN_M * 2:g} m"
    return Table(
        heading="Over the distance driven",
        columns=["", f"first {distance}", f"last {distance}", "change"],
        rows=rows,
    )


def _draw(of_path: dict[str, list[Scores]], options: Options) -> None:
    figure, ((recall, size),) = panels(1, 2, (5.5, 3.6))
    for name, found in of_path.items():
        n_parts = min(len(score["recall"]) for score in found)
        distance = PATH_BIN_M * (np.arange(n_parts) + 0.5)
        for axes, key in ((recall, "recall"), (size, "std_m")):
            values = np.array([score[key][:n_parts] for score in found], dtype=np.float64)
            axes.plot(
                distance, np.nanmedian(values, axis=0), marker="o", markersize=3, label=COVARIANCES[name]
            )
    recall.set_ylabel("recall of moving points, online")
    size.set_ylabel("position in the test, std [m]")
    size.set_yscale("log")
    for axes in (recall, size):
        axes.set_xlabel("distance driven [m]")
        axes.grid(alpha=0.3)
    recall.legend(fontsize=8)
    save(figure, "covariance_over_path", options)


if __name__ == "__main__":
    sys.exit(main(experiment))
