"""Covariances of a match: plain NumPy twins of the kernels, and whether they say the truth.

Over 400 lines because each kernel stands beside its plain twin.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.linalg import covariance_of, mahalanobis2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration import _covariance_kernels
from slammot_graph.registration.point_to_line import PointToLineConfig, match_to_local_map
from tests.registration.keyframes import (
    BEAM_STD_M,
    CONFIG,
    A,
    circle,
    local_map_of,
    pairs_of,
    random_cov,
    scatter_twin,
)
from tests.rooms import CORRIDOR, LASER, box, take_scan

TIGHT = np.diag([0.004, 0.003, 0.002]) ** 2
LOOSE = np.diag([0.1, 0.1, 0.05]) ** 2
NOISE_STD_M, LINE_STD_M = 0.018, 0.003


@dataclass
class MatchCovariances:
    n_weak: int
    information: FloatArray
    graph_information: FloatArray
    gain_information: FloatArray
    cov_independent: FloatArray
    cov_correlated: FloatArray
    cov_map: FloatArray


def judge(
    points: FloatArray, H: FloatArray, parts: list[FloatArray], n_pairs: float, config: PointToLineConfig
) -> MatchCovariances:
    information, graph_information, gain_information, cov_independent, cov_correlated, cov_map = np.empty(
        (6, 3, 3)
    )
    n_weak = _covariance_kernels.match_covariance(
        points,
        np.ones(len(points), dtype=np.bool_),
        np.zeros(3),
        np.zeros(3),
        H,
        np.zeros(3),
        parts[0],
        parts[1],
        parts[2],
        n_pairs,
        config.residual_std_m,
        config.floor_std_m,
        NOISE_STD_M,
        LINE_STD_M,
        config.correlated_std_m,
        config.correlated_std_rad,
        config.kernel_scale_m,
        config.weak_ratio,
        config.fragile_pairs,
        np.empty(3),
        information,
        graph_information,
        gain_information,
        cov_independent,
        cov_correlated,
        cov_map,
    )
    return MatchCovariances(
        n_weak, information, graph_information, gain_information, cov_independent, cov_correlated, cov_map
    )


def judge_twin(
    points: FloatArray,
    H: FloatArray,
    parts: list[FloatArray],
    n_pairs: float,
    config: PointToLineConfig,
    noise_std_m: float = NOISE_STD_M,
    line_std_m: float = LINE_STD_M,
) -> MatchCovariances:
    """In strong directions only: B (3, strong) leads from them, scaled to metres, to the tangent."""
    scale = np.diag([1.0, 1.0, 1.0 / np.sqrt(np.mean(np.sum(points**2, axis=1)))])
    values, V = np.linalg.eigh(scale @ H @ scale)
    strong = values > config.weak_ratio * n_pairs
    values, V = values[strong], V[:, strong]
    B, F = scale @ V, np.linalg.inv(scale) @ V
    pseudo = B @ np.diag(1.0 / values) @ B.T
    white, common, inherited = parts[:3]
    project = B @ F.T
    pose_part = np.diag([config.correlated_std_m, config.correlated_std_m, config.correlated_std_rad]) ** 2
    fragile = B @ np.diag((config.kernel_scale_m * (config.fragile_pairs / values) ** 2) ** 2) @ B.T
    own = noise_std_m**2 * pseudo @ white @ pseudo
    shared = line_std_m**2 * pseudo @ common @ pseudo + project @ pose_part @ project.T
    whole = F.T @ (own + shared + fragile) @ F
    graph = F @ np.diag(1.0 / (config.residual_std_m**2 / values + config.floor_std_m**2)) @ F.T
    return MatchCovariances(
        n_weak=3 - int(strong.sum()),
        information=F @ np.linalg.inv(whole) @ F.T,
        graph_information=graph,
        gain_information=F @ np.diag(values) @ F.T / config.residual_std_m**2,
        cov_independent=own,
        cov_correlated=shared,
        cov_map=pseudo @ inherited @ pseudo + fragile,
    )


def random_problem(
    rng: np.random.Generator, n_normals: int
) -> tuple[FloatArray, FloatArray, list[FloatArray], float]:
    """Points, normal matrix and scatters, made of rows with few or many directions of normals."""
    points = rng.uniform(-6.0, 6.0, (60, 2))
    angles = rng.uniform(0.0, np.pi, n_normals)[rng.integers(0, n_normals, 60)]
    n = np.column_stack([np.cos(angles), np.sin(angles)])
    J = np.column_stack([n, points[:, 0] * n[:, 1] - points[:, 1] * n[:, 0]])
    w = rng.uniform(0.2, 1.0, 60)
    lines = np.add.reduceat(w[:, None] * J, np.arange(0, 60, 12), axis=0)
    root = (w[:, None] * J).T @ J @ (0.02 * rng.normal(size=(3, 3)))
    parts = [(w[:, None] * J).T @ (w[:, None] * J), lines.T @ lines, root @ root.T]
    return points, (w[:, None] * J).T @ J, parts, 60.0


@pytest.mark.parametrize("n_normals", [1, 2, 40])
@pytest.mark.parametrize("fragile_pairs", [0.0, 2.0, 10.0])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15)
def test_judgement_equals_its_twin(seed: int, n_normals: int, fragile_pairs: float) -> None:
    config = PointToLineConfig(fragile_pairs=fragile_pairs, correlated_std_m=0.002, correlated_std_rad=0.003)
    problem = random_problem(np.random.default_rng(seed), n_normals)
    got, expected = judge(*problem, config), judge_twin(*problem, config)
    assert got.n_weak == expected.n_weak
    if n_normals == 1:
        assert got.n_weak >= 1
    for name in (
        "information",
        "graph_information",
        "gain_information",
        "cov_independent",
        "cov_correlated",
        "cov_map",
    ):
        a, b = getattr(got, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7 * max(np.abs(b).max(), 1e-30), err_msg=name)


def fuse(prior: FloatArray, predicted: FloatArray, match: MatchCovariances) -> FloatArray:
    out = np.empty((3, 3))
    _covariance_kernels.fuse(
        prior, predicted, match.gain_information, match.cov_independent, match.cov_map, out
    )
    return out


def fuse_twin(
    prior: FloatArray, predicted: FloatArray, match: MatchCovariances
) -> tuple[FloatArray, FloatArray]:
    """The covariance, and what it would be on a perfect map."""
    gain = np.linalg.inv(np.linalg.inv(prior) + match.gain_information) @ match.gain_information
    kept = np.eye(3) - gain
    fused = kept @ predicted @ kept.T + gain @ match.cov_independent @ gain.T
    # in coordinates in which `fused` is the identity the map's covariance has its own axes
    values, S = np.linalg.eigh(fused)
    whiten = S @ np.diag(values**-0.5) @ S.T
    ratios, axes = np.linalg.eigh(whiten @ match.cov_map @ whiten)
    back = np.linalg.inv(whiten) @ axes
    return back @ np.diag(np.maximum(ratios, 1.0)) @ back.T, fused


@pytest.mark.parametrize("n_normals", [1, 2, 40])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15)
def test_fusion_equals_its_twin_and_is_never_below_the_map(seed: int, n_normals: int) -> None:
    rng = np.random.default_rng(seed)
    prior, predicted = (random_cov(rng) + TIGHT for _ in range(2))
    match = judge(*random_problem(rng, n_normals), CONFIG)
    got, (expected, fused) = fuse(prior, predicted, match), fuse_twin(prior, predicted, match)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    for least in (match.cov_map, fused):
        assert np.linalg.eigvalsh(got - least)[0] > -1e-9 * np.abs(got).max()
    # where the map is perfect, Joseph's form alone
    match.cov_map = np.zeros((3, 3))
    np.testing.assert_allclose(fuse(prior, predicted, match), fused, rtol=1e-6, atol=1e-9 * fused.max())


# but for half a turn, whose sign is free
TURNS = [0.0, 1e-9, -9e-7, 2e-6, 0.01, -1.0, 3.1, 3.2, 4.0, 9.0]


@pytest.mark.parametrize(
    ("n_directions", "size"),
    [(0, 0.1), (1, 0.1), (2, 0.1), (3, 0.1), (1, 100.0), (2, 100.0), (3, 100.0)],
    ids=str,
)
@given(seed=st.integers(0, 10_000), turn=st.sampled_from(TURNS))
@settings(max_examples=25)
def test_innovation_equals_its_twin(seed: int, turn: float, n_directions: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    T_predicted = rng.normal(0.0, [20.0, 20.0, 3.0])
    T_match = se2.compose(T_predicted, np.array([*rng.normal(0.0, 1.0 / size, 2), turn]))
    # of other directions nothing is known
    roots = size * rng.normal(size=(2, 3, n_directions))
    graph_information, information = roots @ np.swapaxes(roots, 1, 2)
    cov_predicted = random_cov(rng, (1.0 / size, 0.5 / size, 2.0 / size)) + 0.1 / size**2 * np.eye(3)
    innovation, cov = np.empty(3), np.empty((3, 3))
    nis = _covariance_kernels.innovate(
        T_predicted, T_match, cov_predicted, graph_information, information, innovation, cov
    )
    expected = se2.log(se2.between(T_predicted, T_match))
    np.testing.assert_allclose(innovation, expected, rtol=1e-9, atol=1e-9)
    barely = 1e-6 * np.eye(3)
    cov_match, cov_cautious = np.linalg.inv(information + barely), np.linalg.inv(graph_information + barely)
    np.testing.assert_allclose(cov, cov_match, rtol=1e-3, atol=1e-4 * cov_match.max())
    np.testing.assert_array_equal(cov, covariance_of(information))
    whole = np.linalg.inv(cov_predicted + cov_cautious)
    assert nis == pytest.approx(expected @ whole @ expected, rel=1e-2)
    assert nis == pytest.approx(
        mahalanobis2(expected, cov_predicted + covariance_of(graph_information)), rel=1e-6
    )


def match_at(
    scan: Scan, local_map: LocalMap, start: FloatArray, cov: FloatArray, max_range: float = np.inf
) -> tuple[MatchResult, FloatArray, FloatArray]:
    return match_to_local_map(
        scan.points_base(), scan.is_valid(max_range), LASER.origin_base, local_map, start, cov, CONFIG
    )


def test_a_match_takes_all_its_covariances_from_there(rng: np.random.Generator) -> None:
    poses = circle(6)
    local_map = local_map_of(poses, rng, covs=np.array([random_cov(rng) for _ in poses]))
    scan = take_scan(A, noise=rng.normal(0.0, BEAM_STD_M, LASER.n_beams))
    result, T, cov = match_at(scan, local_map, se2.compose(A, np.array([0.02, 0.01, 0.01])), LOOSE)
    pairs = pairs_of(scan, local_map, T)
    H = pairs.rows.T @ (pairs.weights[:, None] * pairs.rows)
    points = scan.points_base()[scan.is_valid()]
    residual_m = max(result.residual_m, CONFIG.least_residual_m)
    twin = judge_twin(
        points,
        H,
        list(scatter_twin(pairs, local_map, T)),
        len(np.unique(pairs.rows, axis=0)),
        CONFIG,
        CONFIG.noise_ratio * residual_m,
        CONFIG.line_ratio * residual_m,
    )
    assert (result.status, twin.n_weak) == ("converged", 0)
    np.testing.assert_allclose(result.information, twin.information, rtol=1e-6, atol=1.0)
    np.testing.assert_allclose(result.cov, np.linalg.inv(twin.information), rtol=1e-4, atol=1e-11)
    np.testing.assert_allclose(result.cov_correlated, twin.cov_correlated, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(cov, fuse_twin(LOOSE, LOOSE, twin)[0], rtol=1e-5, atol=1e-10)
    assert np.linalg.eigvalsh(cov - twin.cov_map)[0] > -1e-12
    assert np.linalg.eigvalsh(result.cov - result.cov_correlated)[0] > 0.0


def anees_of(errors: list[FloatArray], covs: list[FloatArray]) -> float:
    return float(np.mean([mahalanobis2(e, cov) for e, cov in zip(errors, covs, strict=True)]))


@pytest.mark.parametrize("seed", [1, 2])
def test_matches_on_noisy_keyframes_err_as_they_say(seed: int) -> None:
    """A new map for each match, so that what matches on one map have in common is drawn anew as well."""
    rng = np.random.default_rng(seed)
    errors, covs = [], []
    for _ in range(60):
        poses = se2.compose(rng.uniform([-1, -1, -0.5], [1, 1, 0.5]) * np.array([0.5, 0.5, 1.0]), circle(5))
        local_map = local_map_of(poses, rng)
        T = se2.compose(poses[-1], rng.uniform([0.0, -0.02, -0.1], [0.3, 0.02, 0.1]))
        scan = take_scan(T, noise=rng.normal(0.0, BEAM_STD_M, LASER.n_beams))
        start = se2.compose(T, rng.normal(0.0, [0.03, 0.03, 0.02]))
        result, _, _ = match_at(scan, local_map, start, LOOSE)
        assert result.status == "converged"
        T_local = se2.compose(local_map.anchor.T_local_base, result.T_ref_base)
        errors.append(se2.log(se2.between(T_local, T)))
        covs.append(result.cov)
    # cautious here: the lines of this room have no error of their own, as walls in the world have
    assert 3.0 / 2.5 < anees_of(errors, covs) < 3.0 * 1.6


@pytest.mark.parametrize("seed", [1, 2])
def test_estimates_on_misplaced_keyframes_err_as_they_say(seed: int) -> None:
    """All keyframes misplaced alike in the axes of the room; the estimate's covariance is then the map's."""
    rng = np.random.default_rng(seed)
    std, errors, covs = np.array([0.02, 0.02, 0.004]), [], []
    for _ in range(60):
        poses = circle(5)
        drawn = rng.normal(0.0, std)
        turned = [np.append(se2.rotation(-pose[2]) @ drawn[:2], drawn[2]) for pose in poses]
        cov = np.diag(std**2)
        local_map = local_map_of(poses, rng, errors=np.array(turned), covs=np.tile(cov, (5, 1, 1)))
        T = se2.compose(A, np.array([0.15, 0.0, 0.05]))
        scan = take_scan(T, noise=rng.normal(0.0, BEAM_STD_M, LASER.n_beams))
        result, T_local, cov_independent = match_at(scan, local_map, T, LOOSE)
        errors.append(se2.log(se2.between(T_local, T)))
        covs.append(cov_independent + result.cov_correlated)
    assert 3.0 / 1.6 < anees_of(errors, covs) < 3.0 * 1.6


def test_a_direction_that_few_pairs_determine_is_not_trusted() -> None:
    """In a corridor a post alone says how far along the robot is, and the post may be somebody."""
    post = box(3.0, -0.1, 3.2, 0.1)
    moved = box(3.06, -0.1, 3.26, 0.1)
    pose = np.array([0.0, 0.0, 0.0])
    local_map = local_map_of(np.array([pose]), walls=np.vstack([CORRIDOR, post]), max_range=4.5)
    along = np.array([1.0, 0.0, 0.0])
    scan = take_scan(pose, walls=np.vstack([CORRIDOR, moved]))
    result, _, cov = match_at(scan, local_map, pose, LOOSE, max_range=4.5)
    assert result.status == "converged"
    assert abs(result.T_ref_base[0]) > 0.03  # it follows the post ...
    assert along @ result.cov @ along > 0.02**2  # ... and knows better than to be sure of it
    assert along @ cov @ along > 0.02**2
    assert np.sqrt(result.cov[1, 1]) < 0.005
    bold = match_to_local_map(
        scan.points_base(),
        scan.is_valid(4.5),
        LASER.origin_base,
        local_map,
        pose,
        LOOSE,
        PointToLineConfig(fragile_pairs=0.0),
    )[0]
    assert along @ bold.cov @ along < 0.3 * along @ result.cov @ along
