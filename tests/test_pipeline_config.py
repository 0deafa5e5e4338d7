from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slammot_graph.core.config import from_plain, load_config, to_plain
from slammot_graph.core.errors import ConfigError
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.localization.config import DeadReckoningConfig, ScanToScanConfig
from slammot_graph.methods import METHODS
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.tracking.no_tracking import NoTrackingConfig

PAPER_DETECTOR = EllipseDetectorConfig(test_covariance=ConstantNoise(), local_grid=None)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"max_range_m": 0.0}, "PipelineConfig.max_range_m must be positive, not 0.0"),
        ({"max_range_m": float("nan")}, "PipelineConfig.max_range_m must be positive, not nan"),
        ({"max_range_m": float("inf")}, "PipelineConfig.max_range_m must be finite, not inf"),
        ({"range_fraction": 1.5}, r"PipelineConfig.range_fraction must be in \(0, 1\], not 1.5"),
        (
            {"localizer": DeadReckoningConfig()},
            'detector.local_grid must be "none": DeadReckoningConfig has no keyframes',
        ),
        (
            {"localizer": ScanToScanConfig(), "detector": EllipseDetectorConfig(local_grid=None)},
            "detector.test_covariance must be a table of constant noise: ScanToScanConfig has no pose graph",
        ),
        (
            {"detector": PAPER_DETECTOR},
            "detector.local_grid must be given: the map of ScanToMapConfig is made",
        ),
    ],
)
def test_impossible_pipelines_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        PipelineConfig(**changes)


def test_parts_may_be_combined_as_long_as_they_fit() -> None:
    PipelineConfig(localizer=ScanToScanConfig(), detector=PAPER_DETECTOR, tracker=NoTrackingConfig())
    PipelineConfig(localizer=DeadReckoningConfig(), detector=NoDetectionConfig())


def load(tmp_path: Path, text: str, method: str = "graph") -> PipelineConfig:
    path = tmp_path / "my.toml"
    path.write_text(text)
    config = load_config(path, METHODS[method].config)
    assert isinstance(config, PipelineConfig)
    return config


def test_a_part_is_exchanged_by_its_type(tmp_path: Path) -> None:
    config = load(tmp_path, '[detector]\ntype = "NoDetectionConfig"\n[tracker]\ntype = "NoTrackingConfig"')
    assert config == METHODS["graph-nofilter"].config
    text = '[localizer]\ntype = "ScanToScanConfig"\n[localizer.point_to_point]\ntau_m = 0.1\n'
    text += '[detector]\nlocal_grid = "none"\n[detector.test_covariance]\nx_std_m = 0.3'
    config = load(tmp_path, text)
    assert isinstance(config.localizer, ScanToScanConfig)
    assert config.localizer.point_to_point.tau_m == 0.1
    assert config.detector == replace(
        EllipseDetectorConfig(), test_covariance=ConstantNoise(x_std_m=0.3), local_grid=None
    )
    assert load(tmp_path, 'detector.test_covariance = "absolute"') == METHODS["graph-absolute"].config


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("detector.ellipse_test.n_sigma = -1", "detector.ellipse_test.n_sigma must be positive, not -1.0"),
        ("detector.retest.crowd_share = 1.5", "detector.retest.crowd_share must be in [0, 1], not 1.5"),
        (
            "detector.local_grid.no_return.min_run = 0",
            "detector.local_grid.no_return.min_run must be at least 1, not 0",
        ),
        ("localizer.local_map.cell_m = nan", "localizer.local_map.cell_m must be positive, not nan"),
        ("localizer.local_map.max_keyframes = 8", "localizer.local_map needs n_overlap < max_keyframes"),
        ("grid.resolution_m = inf", "grid.resolution_m must be finite, not inf"),
        ("grid.p_hit = 0.4", "grid needs 0 < p_min < p_pass < 0.5 < p_hit < p_max < 1"),
        ("max_range_m = -3", "max_range_m must be positive, not -3.0"),
        (
            'detector.local_grid = "none"',
            "detector.local_grid must be given: the map of ScanToMapConfig is made at the end, "
            "there is no other grid to test",
        ),
        ("detector.retets = 3", "detector: unknown key 'retets'; the nearest known key is 'retest'"),
        (
            'detector.test_covariance = "marginal"',
            "detector.test_covariance: expected 'relative' or 'absolute' or a table, not \"marginal\"",
        ),
        (
            'tracker.type = "Kalman"',
            "tracker.type: expected 'NoTrackingConfig' or 'KalmanTrackerConfig' or 'SegmentTrackerConfig',"
            ' not "Kalman"',
        ),
    ],
)
def test_errors_name_the_whole_path_of_the_key(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert str(caught.value) == f"{tmp_path}/my.toml: {error}"


def test_what_is_refused_in_python_names_the_class() -> None:
    with pytest.raises(ConfigError, match=r'EllipseDetectorConfig\.test_covariance must be "relative"'):
        EllipseDetectorConfig(test_covariance="constant")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [name for name in METHODS if not name.startswith("kiss")])
def test_a_method_holds_only_what_it_uses(name: str) -> None:
    config = METHODS[name].config
    assert isinstance(config, PipelineConfig)
    plain = to_plain(config)
    assert from_plain(plain, PipelineConfig()) == config
    assert ("closure" in plain["localizer"]) == config.has_graph
    assert ("point_to_point" in plain["localizer"]) == (name.startswith(("icp", "docpfo")))
    has_test = isinstance(config.detector, EllipseDetectorConfig)
    assert has_test == (len(plain["detector"]) > 1) == (len(plain["tracker"]) > 1)
    if has_test:
        assert (plain["detector"]["local_grid"] is not None) == config.has_graph
