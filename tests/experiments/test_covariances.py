"""Quick modes of the experiments on covariances and on the test's labels."""

from pathlib import Path

import numpy as np
import pytest

from experiments import common, extra_moving_points, fit_p_moving, match_covariances
from slammot_graph.detection.probability import NAMES, WEIGHTS
from tests.experiments.test_scripts import assert_drawn, quick


def test_consistency(tmp_path: Path) -> None:
    text = quick("consistency", tmp_path, ("raw Hessian", "constant R_r", "average NEES", "mean NIS"))
    assert "lab" in text


def test_match_covariances(tmp_path: Path) -> None:
    quick("match_covariances", tmp_path, ("`graph`'s match", "Karto", "kiss-icp"))


def test_the_covariance_of_responses_is_wide_along_a_wall() -> None:
    wall = np.column_stack([np.linspace(-3.0, 3.0, 200), np.full(200, 1.0)])
    cov = match_covariances.karto_covariance(wall, wall, np.zeros(3))
    assert cov[0, 0] > 20.0 * cov[1, 1]
    turned = match_covariances.karto_covariance(
        wall, wall[:, ::-1] * [1.0, -1.0], np.array([0.0, 0.0, np.pi / 2])
    )
    np.testing.assert_allclose(turned[1, 1], cov[0, 0], rtol=0.1)  # of the body's own axes


def test_covariance_ablation(tmp_path: Path) -> None:
    text = quick(
        "covariance_ablation", tmp_path, ("absolute marginal", "relative to the anchor"), "--seeds", "1"
    )
    assert "Over the distance driven" in text
    assert_drawn(tmp_path / "figures" / "covariance_over_path.png")


@pytest.mark.real
def test_reliability(tmp_path: Path) -> None:
    quick("reliability", tmp_path, ("intel", "lab"))
    assert_drawn(tmp_path / "figures" / "reliability.png")


@pytest.mark.real
def test_extra_moving_points(tmp_path: Path) -> None:
    arguments = ["--quick", "--jobs", "1", "--output", str(tmp_path)]
    assert common.main(extra_moving_points.experiment, arguments) == 0
    table = tmp_path / "tables" / "extra_moving_points.md"
    assert "furniture" in table.read_text(encoding="utf-8")
    assert (tmp_path / "figures" / "extra_moving_points.png").stat().st_size > 1000


def test_the_fit_finds_the_weights_that_made_the_data(rng: np.random.Generator) -> None:
    evidence = rng.normal(size=(20_000, len(NAMES)))
    evidence[:, 0] = 1.0
    true = np.linspace(-1.0, 1.0, len(NAMES))
    is_moving = rng.random(len(evidence)) < 1.0 / (1.0 + np.exp(-evidence @ true))
    found = fit_p_moving.fit(evidence, np.ones(len(evidence)), is_moving.astype(np.float64))
    np.testing.assert_allclose(found, true, atol=0.1)
    assert not np.allclose(found, WEIGHTS, atol=0.1)


def test_a_cell_of_the_fit_keeps_the_evidence_of_every_cluster() -> None:
    found = fit_p_moving.cell("two-walkers", None, None, seed=0, n_scans=0)
    assert len(found["evidence"]) == len(found["beams"]) == len(found["moving"]) > 100
    assert np.array(found["evidence"]).shape[1] == len(NAMES)
    assert sum(found["moving"]) > 0.9 * sum(found["beams"])
