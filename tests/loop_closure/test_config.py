import math
from dataclasses import replace

import pytest

from slammot_graph.core.config import from_plain, to_plain
from slammot_graph.core.errors import ConfigError
from slammot_graph.loop_closure import ConsistencyConfig, LoopClosureConfig, SubmapConfig


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        *[
            ({name: 0.0}, f"LoopClosureConfig.{name} must be positive, not 0.0")
            for name in ("min_path_m", "max_distance_m", "drift_scale", "sigma_scale", "gate", "same_pose_m")
        ],
        ({"min_search_m": 0.0}, "LoopClosureConfig.min_search_m must be positive, not 0.0"),
        ({"min_search_m": 9.0}, "LoopClosureConfig.min_search_m must be at most max_search_m"),
        ({"min_search_rad": 1.0}, "LoopClosureConfig.min_search_rad must be at most max_search_rad"),
        *[
            ({name: 0}, f"LoopClosureConfig.{name} must be at least 1, not 0")
            for name in ("n_candidates", "candidate_spacing", "n_search_points_lost", "n_prepared")
        ],
        *[
            ({name: value}, rf"LoopClosureConfig.{name} must be in \[0, 1\], not {value}")
            for name in (
                "min_score",
                "min_overlap",
                "max_free_space_violation",
                "max_ambiguity",
                "turn_lever_quantile",
            )
            for value in (-0.1, 1.1, float("nan"))
        ],
    ],
)
def test_impossible_closures_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        LoopClosureConfig(**changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"max_path_m": 0.0}, "ConsistencyConfig.max_path_m must be positive, not 0.0"),
        ({"std_m": math.nan}, "ConsistencyConfig.std_m must be positive, not nan"),
        ({"std_rad_per_m": -1.0}, "ConsistencyConfig.std_rad_per_m must not be negative, not -1.0"),
        ({"min_number_gap": -1}, "ConsistencyConfig.min_number_gap must not be negative, not -1"),
    ],
)
def test_impossible_consistency_is_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        ConsistencyConfig(**changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"cell_m": 0.0}, "SubmapConfig.cell_m must be positive, not 0.0"),
        ({"n_levels": 0}, "SubmapConfig.n_levels must be at least 1, not 0"),
        ({"free_score": 1}, "SubmapConfig needs free_score <= 0 <= neighbour_score <= occupied_score"),
        ({"max_free_probability": 1.5}, r"SubmapConfig.max_free_probability must be in \[0, 1\], not 1.5"),
    ],
)
def test_impossible_submaps_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        SubmapConfig(**changes)  # type: ignore[arg-type]


def test_parts_are_read_from_plain_values() -> None:
    config = LoopClosureConfig()
    changed = replace(config, submap=SubmapConfig(cell_m=0.2), consistency=ConsistencyConfig(std_m=0.1))
    assert from_plain(to_plain(changed), config) == changed
    assert from_plain({"relocalization": {"n_recent": 5}}, config).relocalization.n_recent == 5
