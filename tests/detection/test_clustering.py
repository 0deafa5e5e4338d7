import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.detection.clustering import ClusterConfig, SplitConfig, find_clusters

NO_LIMIT = ClusterConfig(
    max_gap_m=0.3, max_skipped_beams=2, min_points=1, max_x_range_m=9.0, max_y_range_m=9.0
)


def along_x(*x: float) -> FloatArray:
    return np.column_stack([x, np.zeros(len(x))])


def test_subsets_are_split_at_a_gap() -> None:
    labels, n = find_clusters(along_x(0.0, 0.2, 0.4, 1.0, 1.2), np.ones(5, dtype=bool), NO_LIMIT)
    assert labels.tolist() == [0, 0, 0, 1, 1]
    assert n == 2


def test_a_leg_behind_a_few_other_beams_belongs_to_the_person() -> None:
    points = along_x(0.0, 5.0, 5.0, 0.1, 5.0, 5.0, 5.0, 0.2)
    is_member = points[:, 0] < 1.0
    labels, n = find_clusters(points, is_member, NO_LIMIT)
    assert labels.tolist() == [0, -1, -1, 0, -1, -1, -1, 1]
    assert n == 2


def test_kept_clusters_are_numbered_without_gaps() -> None:
    config = ClusterConfig(max_gap_m=0.3, min_points=2, max_x_range_m=0.5)
    points = along_x(0.0, 2.0, 2.1, 4.0, 4.3, 4.6, 7.0, 7.2)
    labels, n = find_clusters(points, np.ones(8, dtype=bool), config)
    assert labels.tolist() == [-1, 0, 0, -1, -1, -1, 1, 1]
    assert n == 2


def test_people_side_by_side_are_split_where_together_they_are_too_wide() -> None:
    people = np.concatenate([start + 0.05 * np.arange(9) for start in (0.0, 0.65, 1.3)])
    labels, n = find_clusters(along_x(*people), np.ones(27, dtype=bool), ClusterConfig())
    assert n == 3
    assert labels.tolist() == [0] * 9 + [1] * 9 + [2] * 9
    as_in_the_paper = ClusterConfig(split=None)
    labels, n = find_clusters(along_x(*people), np.ones(27, dtype=bool), as_in_the_paper)
    assert n == 0
    assert set(labels) == {-1}


def test_a_wall_and_legs_of_chairs_stay_discarded() -> None:
    wall = along_x(*np.arange(0.0, 3.0, 0.1))
    assert find_clusters(wall, np.ones(30, dtype=bool), ClusterConfig())[1] == 0
    chairs = along_x(*np.concatenate([start + 0.03 * np.arange(2) for start in np.arange(0.0, 3.0, 0.4)]))
    assert find_clusters(chairs, np.ones(len(chairs), dtype=bool), ClusterConfig())[1] == 0


def test_no_members_no_clusters() -> None:
    labels, n = find_clusters(np.full((3, 2), np.nan), np.zeros(3, dtype=bool), NO_LIMIT)
    assert labels.tolist() == [-1, -1, -1]
    assert n == 0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"max_gap_m": 0.0}, "ClusterConfig.max_gap_m must be positive, not 0.0"),
        ({"max_skipped_beams": -1}, "ClusterConfig.max_skipped_beams must not be negative, not -1"),
        ({"min_points": 0}, "ClusterConfig.min_points must be at least 1, not 0"),
        ({"max_x_range_m": 0.0}, "ClusterConfig.max_x_range_m must be positive, not 0.0"),
        ({"max_y_range_m": float("nan")}, "ClusterConfig.max_y_range_m must be positive, not nan"),
    ],
)
def test_impossible_clusters_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        ClusterConfig(**changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"min_points": 0}, "SplitConfig.min_points must be at least 1, not 0"),
        ({"gap_m": -0.1}, "SplitConfig.gap_m must be positive, not -0.1"),
    ],
)
def test_impossible_splits_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        SplitConfig(**changes)  # type: ignore[arg-type]
