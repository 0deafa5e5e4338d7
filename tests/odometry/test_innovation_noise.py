"""Noise of odometry and matches from how their differences follow each other."""

import numpy as np
import pytest

from slammot_graph.odometry.innovation_noise import InnovationNoise, InnovationNoiseConfig

MODEL_M, MODEL_RAD, CLAIMED_M, CLAIMED_RAD = 0.05, 0.04, 0.007, 0.001


def estimated(
    odometry: float, matches: float, *, jitter_s: float = 0.0, persistence: float = 0.0, n: int = 300
) -> InnovationNoise:
    """Estimate from n steps; noise in units of the model and of the claim, odometry read at jittering times."""
    rng = np.random.default_rng(3)
    told = np.column_stack([rng.uniform(0.0, 1.0, n), np.zeros(n), rng.normal(0.0, 0.3, n)])
    stds = np.array([MODEL_M, MODEL_M, MODEL_RAD]), np.array([CLAIMED_M, CLAIMED_M, CLAIMED_RAD])
    w = odometry * stds[0] * rng.normal(size=(n, 3))
    v = matches * stds[1] * rng.normal(size=(n + 1, 3))
    for k in range(1, n + 1):
        v[k] = persistence * v[k - 1] + np.sqrt(1.0 - persistence**2) * v[k]
    late = np.zeros((n + 1, 3))
    late[1:] = jitter_s * rng.normal(size=(n, 1)) * told
    noise = InnovationNoise(InnovationNoiseConfig())
    for e, u in zip(w + np.diff(v, axis=0) + np.diff(late, axis=0), told, strict=True):
        noise.add(e, u, (MODEL_M**2, MODEL_RAD**2), (CLAIMED_M**2, CLAIMED_RAD**2))
    return noise


def test_both_scales_are_found_where_the_matches_claim_too_much() -> None:
    noise = estimated(0.05, 3.0)
    assert noise.match_scale == pytest.approx(3.0, rel=0.25)
    assert all(0.05 <= scale < 0.4 for scale in noise.scales)  # cautious: an upper bound


def test_the_odometry_never_counts_as_worse_than_its_model_here() -> None:
    assert estimated(2.0, 3.0).scales == (1.0, 1.0)


@pytest.mark.parametrize(
    ("odometry", "matches", "options"),
    [
        pytest.param(0.2, 0.8, {}, id="matches as good as they claim"),
        pytest.param(0.05, 2.0, {"persistence": 0.95}, id="errors that the next matches share"),
        pytest.param(0.2, 0.5, {"jitter_s": 0.05}, id="odometry read too early or too late"),
        pytest.param(0.2, 3.0, {"n": 20}, id="too few differences"),
    ],
)
def test_nothing_changes_without_evidence_against_the_matches(
    odometry: float, matches: float, options: dict[str, float]
) -> None:
    noise = estimated(odometry, matches, **options)  # type: ignore[arg-type]
    assert not noise.is_refuted
    assert noise.match_scale == 1.0
    assert noise.scales == (1.0, 1.0)


def test_a_few_leaps_do_not_pass_for_noise() -> None:
    noise = InnovationNoise(InnovationNoiseConfig())
    rng = np.random.default_rng(4)
    for k in range(300):
        e = 0.1 * np.array([MODEL_M, MODEL_M, MODEL_RAD]) * rng.normal(size=3)
        if k % 40 in (0, 1):
            e += 0.5 * (1 - 2 * (k % 2))
        noise.add(e, np.array([0.5, 0.0, 0.1]), (MODEL_M**2, MODEL_RAD**2), (CLAIMED_M**2, CLAIMED_RAD**2))
    assert noise.scales == (1.0, 1.0)
