from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from slammot_graph.baselines.kiss_icp import KissIcpConfig
from slammot_graph.core.errors import ConfigError
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.methods import METHODS, get_method
from slammot_graph.pipeline import PipelineConfig
from slammot_graph.run import Run
from tests.rooms import drive, errors, truth_from_start


def differences(a: str, b: str) -> set[str]:
    """Paths of the parts and fields in which the configurations of two methods differ."""
    first, second = METHODS[a].config, METHODS[b].config
    assert type(first) is type(second)
    return set(differing(first, second))


def differing(first: Any, second: Any, path: str = "") -> Iterator[str]:
    if type(first) is type(second) and is_dataclass(first):
        for f in fields(first):
            yield from differing(getattr(first, f.name), getattr(second, f.name), f"{path}.{f.name}")
    elif first != second:
        yield path.removeprefix(".")


def test_the_ladder_has_its_rungs() -> None:
    main = {"odometry", "icp", "docpfo", "graph", "kiss-icp", "kiss-icp-odometry"}
    ablations = {"graph-fixed", "graph-absolute", "graph-nofilter", "graph-noloop"}
    ablations |= {"icp-every-scan", "docpfo-every-scan"}
    assert main | ablations <= set(METHODS)
    assert all(name == method.name and method.summary for name, method in METHODS.items())


@pytest.mark.parametrize(
    ("a", "b", "names"),
    [
        ("graph", "graph-fixed", {"detector.test_covariance"}),
        ("graph", "graph-absolute", {"detector.test_covariance"}),
        ("graph", "graph-nofilter", {"detector", "tracker"}),
        ("graph", "graph-noloop", {"localizer.close_loops"}),
        ("icp", "odometry", {"localizer"}),
        ("icp", "docpfo", {"detector", "tracker"}),
        ("icp-every-scan", "docpfo-every-scan", {"detector", "tracker"}),
        (  # each at the best setting of its start value
            "kiss-icp",
            "kiss-icp-odometry",
            {"use_odometry", "max_range_m", "max_points_per_voxel", "match_spacing_m"},
        ),
    ],
)
def test_each_rung_is_one_change(a: str, b: str, names: set[str]) -> None:
    assert differences(a, b) == names


def test_a_method_without_a_name_is_refused_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match='no method "grpah"; there are odometry, icp, docpfo, icp-every'):
        get_method("grpah")
    assert get_method("graph") is METHODS["graph"]


def test_defaults_are_the_graph_method() -> None:
    assert METHODS["graph"].config == PipelineConfig()
    assert METHODS["kiss-icp"].config == KissIcpConfig()


@pytest.mark.parametrize("name", METHODS)
def test_every_method_runs_to_finite_results(name: str) -> None:
    log, n = drive(25), 25
    result = Run(log, name).complete()
    assert result.method == name
    assert result.is_complete
    assert result.T_map_base.shape == result.T_map_odom_base.shape == (n, 3)
    for array in (result.stamps, result.T_map_base, result.T_map_odom_base, result.cov_map, result.nodes):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(result.T_map_base[0], np.zeros(3), atol=1e-9)
    assert (np.linalg.eigvalsh(result.cov_map)[:, 0] > 0.0).all()
    assert result.is_valid.shape == result.is_moving.shape == result.is_moving_online.shape == (n, 181)
    assert result.p_moving.dtype == np.float16
    assert not (result.is_moving & ~result.is_valid).any()
    assert result.tracks.shape[1] == 10
    assert (result.grid.p_occupied > 0.5).sum() > 50
    assert all(len(times) == n for times in result.stage_ms.values())
    assert (result.stage_ms["step"] > 0.0).all()
    assert result.stamps.shape == result.nis.shape == (n,)
    assert errors(truth_from_start(log), result.T_map_base)[0] < 0.7


# kiss-icp sums up in parallel, in no fixed order
@pytest.mark.parametrize("name", [name for name in METHODS if not name.startswith("kiss")])
def test_a_run_twice_gives_the_same_bits(name: str) -> None:
    log = drive(25)
    first, second = Run(log, name).complete(), Run(log, name).complete()
    for array in ("T_map_base", "cov_map", "is_moving", "p_moving", "tracks", "nodes", "nis"):
        np.testing.assert_array_equal(getattr(first, array), getattr(second, array))
    np.testing.assert_array_equal(first.grid.p_occupied, second.grid.p_occupied)


def test_odometry_is_the_odometry() -> None:
    result = Run(drive(20), "odometry").complete()
    assert errors(result.T_map_base, result.T_map_odom_base) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_graph_is_nearer_to_the_truth_than_the_odometry() -> None:
    log = drive(60)
    truth = truth_from_start(log)
    result = Run(log, "graph").complete()
    assert errors(truth, result.T_map_base)[0] < 0.2 * errors(truth, result.T_map_odom_base)[0]


def test_an_own_configuration_takes_the_place_of_the_methods() -> None:
    own = replace(PipelineConfig(), detector=NoDetectionConfig())
    assert Run(drive(2), config=own).config is own
    assert Run(drive(2), "kiss-icp", max_range_m=7.0).config.max_range_m == 7.0
