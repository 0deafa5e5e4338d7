"""The flat keys of release 0.1, accepted for one more release: where each of them lies today.

In that release zeros and flags switched parts off whose other keys stayed in the file; here such a part is "none".
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.localization.config import DeadReckoningConfig, ScanToMapConfig, ScanToScanConfig
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.tracking.no_tracking import NoTrackingConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.tracker import KalmanTrackerConfig

if TYPE_CHECKING:
    from slammot_graph.pipeline_config import PipelineConfig

MOVED = {
    "matcher": "localizer",
    "n_lost": "localizer.n_lost",
    "close_loops": "localizer.close_loops",
    "local_map": "localizer.local_map",
    "graph": "localizer.graph",
    "point_to_point": "localizer.point_to_point",
    "point_to_line": "localizer.point_to_line",
    "point_to_line.common_std_m": "localizer.point_to_line.correlated_std_m",
    "point_to_line.common_std_rad": "localizer.point_to_line.correlated_std_rad",
    "closure": "localizer.closure",
    "closure.max_contradiction": "localizer.closure.max_free_space_violation",
    "closure.surprise": "localizer.closure.gate_scale",
    "closure.point_to_line.common_std_m": "localizer.closure.point_to_line.correlated_std_m",
    "closure.point_to_line.common_std_rad": "localizer.closure.point_to_line.correlated_std_rad",
    "filter_moving": "detector",
    "test_covariance": "detector.test_covariance",
    "constant_noise": "detector.test_covariance",
    "judge_again": "detector.retest",
    "crowd_share": "detector.retest.crowd_share",
    "motion": "detector.ellipse_test",
    "motion.stand_back_share": "detector.ellipse_test.abstain_share",
    "motion.stand_back_nis": "detector.retest.abstain_nis",
    "motion.is_common_mode": "detector.ellipse_test.common_mode",
    "clusters": "detector.clusters",
    "clusters.split_gap_m": "detector.clusters.split",
    "clusters.split_min_points": "detector.clusters.split.min_points",
    "afterimage": "detector.visibility_check",
    "afterimage.reach_m": "detector.visibility_check",
    "afterimage.way_m": "detector.visibility_check.distance_m",
    "hindsight": "detector.backward_pass",
    "local_grid": "detector.local_grid",
    "n_window_keyframes": "detector.local_grid.n_keyframes",
    "free_no_return_m": "detector.local_grid.no_return",
    "occupy_with_moving": "grid.occupy_with_moving",
    "tracks": "tracker",
    "tracks.min_way_m": "tracker.min_distance_m",
}
"""New path of each old key; the longest one that a key begins with counts."""

DROPPED = (
    "localizer.max_counted_nis",
    "localizer.nis_gain",
    "localizer.jump_inlier_ratio",
    "localizer.jump_nis",
    "localizer.jump_inlier_gain",
    "localizer.point_to_line.max_nis",
    "localizer.closure.point_to_line.max_nis",
    "localizer.closure.relocalization.min_agreeing_alone",
    "localizer.closure.relocalization.lead",
)
"""Paths that were of release 0.1 or lay beside its keys: matches are no longer refused for their innovation, and a lost
robot's place is decided by what was seen there, not by how many local maps agree."""

_LOCALIZERS = {"none": DeadReckoningConfig, "scan-to-scan": ScanToScanConfig, "scan-to-map": ScanToMapConfig}

_CONVERTED: dict[str, Callable[[Any], Any]] = {
    "matcher": lambda name: {"type": _LOCALIZERS[name].__name__ if name in _LOCALIZERS else name},
    "filter_moving": lambda on: {"type": (EllipseDetectorConfig if on else NoDetectionConfig).__name__},
    "test_covariance": lambda name: {} if name == "constant" else name,
    "judge_again": lambda on: {} if on else "none",
    "motion.is_common_mode": lambda on: {} if on else "none",
    "motion.margin_cells": lambda n: n or "none",
    "motion.track_reach_m": lambda reach_m: reach_m or "none",
    "clusters.split_gap_m": lambda gap_m: {"gap_m": gap_m} if gap_m else "none",
    "afterimage.reach_m": lambda reach_m: {"reach_m": reach_m} if reach_m else "none",
    "free_no_return_m": lambda reach_m: {"reach_m": reach_m} if reach_m else "none",
}
"""New values of old ones, where they are not the same."""

_SWITCHES = {
    "detector.retest": "judge_again",
    "detector.clusters.split": "clusters.split_gap_m",
    "detector.visibility_check": "afterimage.reach_m",
}
"""The old key that alone puts a part in where the method has none."""


def with_new_keys(values: Mapping[str, Any], default: "PipelineConfig", source: str) -> Mapping[str, Any]:
    """Move values from old keys to new ones, leave out those that are no longer used, and say so in a warning.

    Parameters
    ----------
    values : mapping
        Nested plain values; returned as they are where no key is an old one.
    default : PipelineConfig
        What they are to be laid over.
    source : str
        Where they come from.

    Warns
    -----
    DeprecationWarning
        With the new place of each old key, and with the keys that are no longer used.
    """
    if not any(key in MOVED for key in values):
        kept = _copied(values)
        dropped = _drop(kept)
        if not dropped:
            return values
        warnings.warn(
            f"{source}: these keys are no longer used, the next release will not know them: {', '.join(dropped)}",
            DeprecationWarning,
            stacklevel=2,
        )
        return kept
    old = dict(_leaves(values))
    parts = _Parts.of(old, default)
    new, told = _moved(old, parts)
    dropped = _drop(new)
    for path, switch in _SWITCHES.items():
        if switch not in old and _at(default, path) is None:
            _remove(new, path)
    _fit(new, parts)
    text = ", ".join(f"{key} -> {path}" for key, path in told.items())
    if dropped:
        text += f"; no longer used: {', '.join(dropped)}"
    warnings.warn(
        f"{source}: these keys have moved, the next release will not know them: {text}",
        DeprecationWarning,
        stacklevel=2,
    )
    return new


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """The parts that old values and what they are laid over have together."""

    localizer: type[Any]
    has_detector: bool
    has_local_grid_by_default: bool
    has_constant_noise: bool

    @property
    def has_graph(self) -> bool:
        return self.localizer is ScanToMapConfig

    @classmethod
    def of(cls, old: Mapping[str, Any], default: "PipelineConfig") -> "_Parts":
        detector = default.detector if isinstance(default.detector, EllipseDetectorConfig) else None
        noise = old.get("test_covariance")
        if noise is None and detector is not None:
            noise = "constant" if isinstance(detector.test_covariance, ConstantNoise) else None
        return cls(
            localizer=_LOCALIZERS.get(old.get("matcher", ""), type(default.localizer)),
            has_detector=old.get("filter_moving", detector is not None),
            has_local_grid_by_default=detector is not None and detector.local_grid is not None,
            has_constant_noise=noise == "constant",
        )


def _moved(old: Mapping[str, Any], parts: _Parts) -> tuple[dict[str, Any], dict[str, str]]:
    """Give the values (dotted keys) as nested ones under their new keys, and which roots have moved where."""
    new: dict[str, Any] = {}
    told: dict[str, str] = {}
    for key, value in old.items():
        root = next((root for root in _roots(key) if root in MOVED), None)
        path = key if root is None else MOVED[root] + key[len(root) :]
        if root is not None:
            told[root] = MOVED[root]
        if key.startswith("constant_noise.") and not parts.has_constant_noise:
            continue
        if key == "free_no_return_m" and not parts.has_graph:
            path = "grid.no_return"
        _put(new, path, _CONVERTED[key](value) if key in _CONVERTED else value)
        if key == "occupy_with_moving":
            _put(new, "detector.local_grid.occupy_with_moving", value)
    return new, told


def _fit(new: dict[str, Any], parts: _Parts) -> None:
    """Leave out what the parts do not know, as old files named the keys of all of them; put in what they need."""
    if "localizer" in new:
        known = {"type", *(field.name for field in fields(parts.localizer))}
        new["localizer"] = {key: value for key, value in new["localizer"].items() if key in known}
    if parts.has_graph and "tracker" in new:  # noise of clusters, and an end that knew no occlusion
        known = {field.name for field in fields(SegmentTrackerConfig)} - {"max_missed_s"}
        new["tracker"] = {key: value for key, value in new["tracker"].items() if key in known}
    if not parts.has_detector:
        new["detector"] = {"type": NoDetectionConfig.__name__}
        new["tracker"] = {"type": NoTrackingConfig.__name__}
    elif not parts.has_graph:
        _put(new, "detector.local_grid", "none")
        _put(new, "tracker.type", KalmanTrackerConfig.__name__)
    elif not parts.has_local_grid_by_default:
        _put(new, "detector.local_grid", {})


def _copied(values: Mapping[str, Any]) -> dict[str, Any]:
    """Copy nested tables."""
    return {key: _copied(value) if isinstance(value, Mapping) else value for key, value in values.items()}


def _drop(tree: dict[str, Any]) -> list[str]:
    """Remove what is no longer used, and tables that are empty without it; gives its paths."""
    found = list[str]()
    for path in DROPPED:
        parents, last = path.split(".")[:-1], path.split(".")[-1]
        tables: list[Any] = [tree]
        for name in parents:
            tables.append(tables[-1].get(name) if isinstance(tables[-1], dict) else None)
        if not isinstance(tables[-1], dict) or last not in tables[-1]:
            continue
        del tables[-1][last]
        found.append(path)
        for table, name in zip(tables[-2::-1], reversed(parents), strict=True):
            if not table[name]:
                del table[name]
    return found


def _leaves(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Give the dotted paths of all values that are no tables."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _roots(key: str) -> Iterator[str]:
    """Give a dotted path and the shorter ones that it begins with."""
    while key:
        yield key
        key = key.rpartition(".")[0]


def _put(tree: dict[str, Any], path: str, value: Any) -> None:
    """Set a value in nested dicts; "none" stands for a whole part, whatever else is said of it."""
    *parents, last = path.split(".")
    for name in parents:
        tree = tree.setdefault(name, {})
        if not isinstance(tree, dict):
            return
    if not isinstance(value, dict):
        tree[last] = value
    elif isinstance(tree.setdefault(last, {}), dict):
        tree[last].update(value)


def _remove(tree: dict[str, Any], path: str) -> None:
    *parents, last = path.split(".")
    for name in parents:
        tree = tree.get(name, {})
        if not isinstance(tree, dict):
            return
    tree.pop(last, None)


def _at(config: Any, path: str) -> Any:
    """Give the part of a configuration at a dotted path; None where there is none."""
    for name in path.split("."):
        config = getattr(config, name, None)
    return config
