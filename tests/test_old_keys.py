from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slammot_graph.core.config import load_config, to_toml
from slammot_graph.core.errors import ConfigError
from slammot_graph.detection.clustering import SplitConfig
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig, RetestConfig
from slammot_graph.detection.ellipse_test import CommonModeConfig
from slammot_graph.detection.no_detection import NoDetectionConfig
from slammot_graph.localization.config import ScanToMapConfig, ScanToScanConfig
from slammot_graph.methods import METHODS
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.old_keys import DROPPED
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig

SETTINGS = Path(__file__).parent / "settings_of_0_1"
"""Whole files of two methods, as release 0.1 wrote them."""
OLD_GRAPH = (SETTINGS / "graph.toml").read_text(encoding="utf-8")
OLD_PAPER = (SETTINGS / "docpfo.toml").read_text(encoding="utf-8")


def load(tmp_path: Path, text: str, method: str = "graph") -> PipelineConfig:
    path = tmp_path / "old.toml"
    path.write_text(text)
    with pytest.warns(DeprecationWarning, match=r"old\.toml: these keys have moved"):
        config = load_config(path, METHODS[method].config)
    assert isinstance(config, PipelineConfig)
    return config


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (OLD_GRAPH, "graph"),
        (OLD_GRAPH.replace("filter_moving = true", "filter_moving = false"), "graph-nofilter"),
        (OLD_GRAPH.replace('"relative"', '"constant"'), "graph-fixed"),
        (OLD_GRAPH.replace('"relative"', '"absolute"'), "graph-absolute"),
        (OLD_GRAPH.replace("close_loops = true", "close_loops = false"), "graph-noloop"),
        (OLD_PAPER, "docpfo-every-scan"),
        (OLD_PAPER.replace("filter_moving = true", "filter_moving = false"), "icp-every-scan"),
        (
            OLD_PAPER.replace("filter_moving = true", "filter_moving = false").replace(
                "scan-to-scan", "none"
            ),
            "odometry",
        ),
    ],
)
@pytest.mark.parametrize("over", ["itself", "graph"])
def test_a_whole_file_of_the_earlier_release_is_the_same_method(
    tmp_path: Path, text: str, name: str, over: str
) -> None:
    assert load(tmp_path, text, name if over == "itself" else over) == METHODS[name].config


def detector(**changes: Any) -> PipelineConfig:
    return PipelineConfig(detector=replace(EllipseDetectorConfig(), **changes))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("n_lost = 7", PipelineConfig(localizer=ScanToMapConfig(n_lost=7))),
        ("close_loops = false", PipelineConfig(localizer=ScanToMapConfig(close_loops=False))),
        ("tracks.n_confirm = 5", PipelineConfig(tracker=SegmentTrackerConfig(n_confirm=5))),
        ("hindsight = false", detector(backward_pass=False)),
        ("judge_again = false", detector(retest=None)),
        ("crowd_share = 0.3", detector(retest=RetestConfig(crowd_share=0.3))),
        ("motion.stand_back_nis = 9.0", detector(retest=RetestConfig(abstain_nis=9.0))),
        ("afterimage.reach_m = 0.0", detector(visibility_check=None)),
        ('test_covariance = "constant"', detector(test_covariance=ConstantNoise())),
        (
            'test_covariance = "constant"\nconstant_noise.x_std_m = 0.2',
            detector(test_covariance=ConstantNoise(x_std_m=0.2)),
        ),
        ("constant_noise.x_std_m = 0.2", PipelineConfig()),
    ],
)
def test_an_old_key_is_moved(tmp_path: Path, text: str, expected: PipelineConfig) -> None:
    assert load(tmp_path, text) == expected


def test_old_and_new_keys_may_stand_together(tmp_path: Path) -> None:
    text = "motion.is_common_mode = true\nmax_range_m = 9.0\n[detector.clusters]\nmin_points = 3"
    config = load(tmp_path, text)
    assert isinstance(config.detector, EllipseDetectorConfig)
    assert config.detector.ellipse_test.common_mode == CommonModeConfig()
    assert (config.detector.clusters.min_points, config.max_range_m) == (3, 9.0)


def test_keys_of_a_part_that_the_method_does_not_have_put_none_in(tmp_path: Path) -> None:
    text = "crowd_share = 0.3\nclusters.split_min_points = 4\nafterimage.way_m = 0.2"
    assert load(tmp_path, text, "docpfo") == METHODS["docpfo"].config
    config = load(tmp_path, "clusters.split_gap_m = 0.2\njudge_again = true", "docpfo")
    assert isinstance(config.detector, EllipseDetectorConfig)
    assert config.detector.clusters.split == SplitConfig(gap_m=0.2)
    assert config.detector.retest == RetestConfig()


def test_another_matcher_brings_its_own_part(tmp_path: Path) -> None:
    text = 'matcher = "scan-to-scan"\ntest_covariance = "constant"\npoint_to_point.tau_m = 0.1'
    config = load(tmp_path, text)
    assert isinstance(config.localizer, ScanToScanConfig)
    assert config.localizer.point_to_point.tau_m == 0.1
    assert load(tmp_path, "filter_moving = false").detector == NoDetectionConfig()


def test_the_warning_names_each_new_key(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text("n_lost = 3\n[motion]\nn_sigma = 3.0\nstand_back_share = 0.5")
    with pytest.warns(DeprecationWarning) as told:
        load_config(path, PipelineConfig())
    assert len(told) == 1
    assert str(told[0].message) == (
        f"{path}: these keys have moved, the next release will not know them: n_lost -> localizer.n_lost, "
        "motion -> detector.ellipse_test, motion.stand_back_share -> detector.ellipse_test.abstain_share"
    )


def test_a_bad_value_is_told_by_its_new_path(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"old\.toml: detector\.ellipse_test\.n_sigma must be positive, not -1"
    ):
        load(tmp_path, "motion.n_sigma = -1")
    with pytest.raises(ConfigError, match=r"old\.toml: detector\.ellipse_test: unknown key 'n_sigmas'"):
        load(tmp_path, "motion.n_sigmas = 1")
    with pytest.raises(ConfigError, match=r"old\.toml: localizer\.type: expected 'DeadReckoningConfig' or"):
        load(tmp_path, 'matcher = "icp"')


@pytest.mark.parametrize("name", [name for name in METHODS if not name.startswith("kiss")])
def test_todays_files_are_read_without_a_warning(tmp_path: Path, name: str) -> None:
    path = tmp_path / "new.toml"
    path.write_text(to_toml(METHODS[name].config))
    for method in METHODS.values():
        if isinstance(method.config, PipelineConfig):
            assert load_config(path, method.config) == METHODS[name].config


DROPPED_KEYS = """
localizer.nis_gain = 0.2
localizer.max_counted_nis = 40.0
localizer.jump_nis = 30.0
localizer.jump_inlier_ratio = 0.5
localizer.jump_inlier_gain = 0.1
localizer.point_to_line.max_nis = 9.0
localizer.closure.point_to_line.max_nis = 9.0
localizer.closure.relocalization.min_agreeing_alone = 4
localizer.closure.relocalization.lead = 3.0
"""


@pytest.mark.parametrize("method", ["graph", "docpfo", "odometry"])
def test_keys_that_are_no_longer_used_are_left_out(tmp_path: Path, method: str) -> None:
    path = tmp_path / "old.toml"
    path.write_text(DROPPED_KEYS)
    with pytest.warns(DeprecationWarning) as told:
        config = load_config(path, METHODS[method].config)
    assert config == METHODS[method].config
    assert len(told) == 1
    text = str(told[0].message)
    assert text.startswith(f"{path}: these keys are no longer used, the next release will not know them: ")
    assert all(name in text for name in DROPPED)


def test_other_keys_beside_those_that_are_no_longer_used_count(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text(DROPPED_KEYS + "localizer.n_lost = 7\nlocalizer.point_to_line.min_pairs = 20")
    with pytest.warns(DeprecationWarning, match="no longer used"):
        config = load_config(path, PipelineConfig())
    expected = ScanToMapConfig(n_lost=7)
    point_to_line = replace(expected.point_to_line, min_pairs=20)
    assert config == PipelineConfig(localizer=replace(expected, point_to_line=point_to_line))


def test_the_warning_tells_moved_keys_from_those_no_longer_used(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text("n_lost = 3\npoint_to_line.max_nis = 9.0")
    with pytest.warns(DeprecationWarning) as told:
        config = load_config(path, PipelineConfig())
    assert config == PipelineConfig(localizer=ScanToMapConfig(n_lost=3))
    assert str(told[0].message).endswith("; no longer used: localizer.point_to_line.max_nis")
