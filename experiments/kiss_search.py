"""A search for kiss-icp's best setting in 2D: what the baseline of the other experiments is held to."""

import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from itertools import islice, product
from typing import Any

import numpy as np

from experiments import recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, number, write_tables
from slammot_graph import open_log
from slammot_graph.baselines.kiss_icp import KissIcpConfig, KissIcpPipeline
from slammot_graph.core.scan import Scan
from slammot_graph.evaluation import evaluate_relations
from slammot_graph.methods import get_method

METHODS = {False: "kiss-icp", True: "kiss-icp-odometry"}
"""By `use_odometry`, the start value of each registration."""
LOGS = ("intel", "aces")
N_SCANS, QUICK_SCANS = 800, 120
MAX_DURATION_S = 10.0

VOXELS_M = (0.1, 0.2, 0.3, 0.5, 1.0)
SPACINGS_M = ((None, None), (0.05, 0.05), (0.05, 0.1))
"""Of the map and of the match; None is kiss-icp's own."""
THRESHOLDS_M = (0.1, 0.3, None)
"""None is kiss-icp's adaptive one."""
RANGES_M = (10.0, 20.0, 40.0)
POINTS = (20, 40)
FIRST = {"max_range_m": 20.0, "max_points_per_voxel": 40}
"""What the first stage holds fixed."""
N_BEST = 6
"""So many of the first stage go on to the second, for each start value."""

DEFAULTS = KissIcpConfig(
    max_range_m=100.0,
    min_range_m=1e-3,
    voxel_size_m=1.0,
    max_points_per_voxel=20,
    fixed_threshold_m=None,
    map_spacing_m=None,
    match_spacing_m=None,
)
"""kiss-icp's own (its voxel is a hundredth of its range); its least range is 0, which here has to be positive."""
SEARCHED = (
    "use_odometry",
    "voxel_size_m",
    "map_spacing_m",
    "match_spacing_m",
    "fixed_threshold_m",
    "max_range_m",
    "max_points_per_voxel",
    "min_range_m",
)
COLUMNS = ("voxel [m]", "map [m]", "match [m]", "threshold [m]", "range [m]", "points per voxel")

Setting = tuple[Any, ...]
"""Values of what is `SEARCHED`."""


def cell(log: str, n_scans: int, setting: dict[str, Any]) -> Scores:
    """Run kiss-icp with one setting over a log's first scans."""
    scans = _first_scans(log, n_scans)
    pipeline = KissIcpPipeline(KissIcpConfig(**setting))
    took_ms = [pipeline.step(scan).stage_ms["step"] for scan in scans]
    stamps, T_map_base = np.array([scan.stamp for scan in scans]), pipeline.final().T_map_base
    relations = recorded.relations_of(log)
    near = evaluate_relations(stamps, T_map_base, relations, max_duration_s=MAX_DURATION_S)
    everything = evaluate_relations(stamps, T_map_base, relations)
    return {
        "near_m": near.translation_m.mean,
        "near_deg": near.rotation_deg.mean,
        "n_near": near.translation_m.n,
        "all_m": everything.translation_m.mean,
        "n_all": everything.translation_m.n,
        "ms": float(np.median(took_ms)),
    }


@lru_cache(maxsize=len(LOGS))
def _first_scans(log: str, n_scans: int) -> list[Scan]:
    return list(islice(open_log(log), n_scans))


def experiment(options: Options) -> None:
    """Search kiss-icp's settings on two recorded logs: a grid, then range and points around its best ones."""
    logs = LOGS[:1] if options.quick else LOGS
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    starts = (False,) if options.quick else (False, True)
    search = _Search(logs, n_scans, options)
    known = [_setting(replace(DEFAULTS, use_odometry=start)) for start in starts]
    known += [_setting(_used(start)) for start in starts]
    search.run([*known, *_first_stage(starts, options.quick)])
    if not options.quick:
        search.run(_second_stage([setting for start in starts for setting in search.best(start)[:N_BEST]]))
    n_near, n_all = (
        ", ".join(f"{log} {search.scores[known[0]][log][name]}" for log in logs)
        for name in ("n_near", "n_all")
    )
    notes = [
        f"The first {n_scans} scans of each log. Score: mean translation error [m] of the true relations whose ends"
        f" lie under {MAX_DURATION_S:g} s apart, averaged over the logs; the best setting first."
        f" Relations used: {n_near}; of all lengths: {n_all}.",
        "",
        f"Stage 1 is a full grid of voxel, spacing and threshold at {FIRST['max_range_m']:g} m range and"
        f" {FIRST['max_points_per_voxel']} points per voxel. Stage 2 takes its {N_BEST} best settings of either start"
        f" value through ranges of {', '.join(f'{value:g}' for value in RANGES_M)} m and"
        f" {' and '.join(map(str, POINTS))} points per voxel.",
        "",
        "Map and match: sub-sampling of the scan for the map and for the match; own: kiss-icp's, half a voxel and"
        " one and a half voxels. Milliseconds: median of `register_frame` alone, under the load of all processes.",
    ]
    tables = [search.table(start) for start in starts]
    write_tables("kiss_search", "kiss-icp's settings in 2D", notes, tables, options)


class _Search:
    """Settings tried so far, with their scores on each log."""

    def __init__(self, logs: tuple[str, ...], n_scans: int, options: Options) -> None:
        self.logs = logs
        self.n_scans = n_scans
        self.options = options
        self.paths = {log: str(options.recorded(f"{log}.clf.bz2")) for log in logs}
        self.scores: dict[Setting, dict[str, Scores]] = {}

    def run(self, settings: Iterable[Setting]) -> None:
        """Try settings; those that were tried already are not run again."""
        new = [setting for setting in dict.fromkeys(settings) if setting not in self.scores]
        cells = {
            self._key(log, setting): {
                "log": self.paths[log],
                "n_scans": self.n_scans,
                "setting": dict(zip(SEARCHED, setting, strict=True)),
            }
            for setting in new
            for log in self.logs
        }
        scores = run_cells("kiss_search", cell, cells, self.options)
        self.options = replace(self.options, fresh=False)  # a later stage keeps what the first one wrote
        for setting in new:
            self.scores[setting] = {log: scores[self._key(log, setting)] for log in self.logs}

    def _key(self, log: str, setting: Setting) -> str:
        words = [f"{name}={value}" for name, value in zip(SEARCHED, setting, strict=True)]
        return " ".join([log, str(self.n_scans), *words])

    def mean(self, setting: Setting, name: str) -> float:
        """A score averaged over the logs."""
        return float(np.mean([self.scores[setting][log][name] for log in self.logs]))

    def best(self, use_odometry: bool) -> list[Setting]:
        """All settings of a start value, the best first, without a score last."""
        own = [setting for setting in self.scores if setting[0] == use_odometry]
        return sorted(own, key=lambda setting: np.nan_to_num(self.mean(setting, "near_m"), nan=np.inf))

    def table(self, use_odometry: bool) -> Table:
        """All settings of a start value, the best first."""
        rows = []
        names = {
            _setting(replace(DEFAULTS, use_odometry=use_odometry)): " (kiss-icp's defaults)",
            _setting(_used(use_odometry)): f" (**used as `{METHODS[use_odometry]}`**)",
        }
        for rank, setting in enumerate(self.best(use_odometry), start=1):
            scores = self.scores[setting]
            rows.append(
                [
                    f"{rank}{names.get(setting, '')}",
                    *_cells(setting),
                    number(self.mean(setting, "near_m"), 4),
                    *(number(scores[log]["near_m"], 4) for log in self.logs),
                    *(number(scores[log]["all_m"], 4) for log in self.logs),
                    *(number(scores[log]["ms"], 2) for log in self.logs),
                ]
            )
        columns = [
            "rank",
            *COLUMNS,
            "score [m]",
            *(f"{log} under {MAX_DURATION_S:g} s [m]" for log in self.logs),
            *(f"{log} all [m]" for log in self.logs),
            *(f"{log} ms per scan" for log in self.logs),
        ]
        start = "the odometry" if use_odometry else "the last motion"
        return Table(heading=f"Started from {start}", columns=columns, rows=rows)


def _first_stage(starts: Iterable[bool], quick: bool) -> list[Setting]:
    grid = product(starts, VOXELS_M, SPACINGS_M, THRESHOLDS_M)
    settings = [
        _setting(
            KissIcpConfig(
                use_odometry=start,
                voxel_size_m=voxel,
                map_spacing_m=for_map,
                match_spacing_m=for_match,
                fixed_threshold_m=threshold,
                **FIRST,  # type: ignore[arg-type]
            )
        )
        for start, voxel, (for_map, for_match), threshold in grid
    ]
    return settings[-1:] if quick else settings


def _second_stage(best: Iterable[Setting]) -> list[Setting]:
    return [
        _setting(replace(_config(setting), max_range_m=reach, max_points_per_voxel=points))
        for setting, reach, points in product(best, RANGES_M, POINTS)
    ]


def _used(use_odometry: bool) -> KissIcpConfig:
    config = get_method(METHODS[use_odometry]).config
    assert isinstance(config, KissIcpConfig)
    return config


def _setting(config: KissIcpConfig) -> Setting:
    return tuple(getattr(config, name) for name in SEARCHED)


def _config(setting: Setting) -> KissIcpConfig:
    return KissIcpConfig(**dict(zip(SEARCHED, setting, strict=True)))


def _cells(setting: Setting) -> list[str]:
    config = _config(setting)
    threshold = "adaptive" if config.fixed_threshold_m is None else f"{config.fixed_threshold_m:g}"
    return [
        f"{config.voxel_size_m:g}",
        *(
            "own" if value is None else f"{value:g}"
            for value in (config.map_spacing_m, config.match_spacing_m)
        ),
        threshold,
        f"{config.max_range_m:g}",
        str(config.max_points_per_voxel),
    ]


if __name__ == "__main__":
    sys.exit(main(experiment))
