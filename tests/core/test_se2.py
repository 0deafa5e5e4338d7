import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray

coordinates = st.floats(-50.0, 50.0)
angles = st.floats(-10.0, 10.0)
poses = st.builds(lambda x, y, theta: np.array([x, y, theta]), coordinates, coordinates, angles)
# below half a turn, where the logarithm is unique
tangents = st.builds(lambda x, y, w: np.array([x, y, w]), coordinates, coordinates, st.floats(-3.1, 3.1))


def assert_same(a: FloatArray, b: FloatArray, atol: float = 1e-9) -> None:
    assert a.shape == b.shape
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=atol)
    np.testing.assert_allclose(se2.wrap_angle(a[..., 2] - b[..., 2]), 0.0, atol=atol)


def oracle(T: FloatArray) -> gtsam.Pose2:
    return gtsam.Pose2(*T.tolist())


def array(pose: gtsam.Pose2) -> FloatArray:
    return np.array([pose.x(), pose.y(), pose.theta()])


@given(poses, poses, poses)
def test_composition_is_associative(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    assert_same(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(poses)
def test_identity_and_inverse(a: FloatArray) -> None:
    assert_same(se2.compose(a, se2.IDENTITY), a)
    assert_same(se2.compose(se2.IDENTITY, a), a)
    assert_same(se2.compose(a, se2.inverse(a)), se2.IDENTITY)
    assert_same(se2.compose(se2.inverse(a), a), se2.IDENTITY)
    assert_same(se2.inverse(se2.inverse(a)), a)


@given(poses, poses)
def test_between_undoes_compose(a: FloatArray, b: FloatArray) -> None:
    assert_same(se2.between(a, se2.compose(a, b)), b)


@given(tangents)
def test_log_inverts_exp(v: FloatArray) -> None:
    np.testing.assert_allclose(se2.log(se2.exp(v)), v, atol=1e-7)


@given(poses)
def test_exp_inverts_log(a: FloatArray) -> None:
    assert_same(se2.exp(se2.log(a)), a, atol=1e-6)


@pytest.mark.parametrize("w", [0.0, 1e-12, 1e-7, 9.9e-7, 1.1e-6, 1e-5, -1e-7])
def test_exp_and_log_hold_near_zero_rotation(w: float) -> None:
    v = np.array([3.0, -2.0, w])
    # the series of both maps to second order
    expected = np.array([3.0 + w, -2.0 + 1.5 * w, w])
    np.testing.assert_allclose(se2.exp(v), expected, atol=1e-9)
    np.testing.assert_allclose(se2.log(se2.exp(v)), v, atol=1e-9)


@given(poses, poses)
def test_group_agrees_with_gtsam(a: FloatArray, b: FloatArray) -> None:
    assert_same(se2.compose(a, b), array(oracle(a).compose(oracle(b))))
    assert_same(se2.inverse(a), array(oracle(a).inverse()))
    assert_same(se2.between(a, b), array(oracle(a).between(oracle(b))))
    np.testing.assert_allclose(se2.adjoint(a), oracle(a).AdjointMap(), atol=1e-9)


@given(tangents)
def test_maps_agree_with_gtsam(v: FloatArray) -> None:
    if 0.0 < abs(v[2]) < 1e-6:  # gtsam divides by such an angle, and loses digits
        v[2] = 0.0
    pose = gtsam.Pose2.Expmap(v)
    assert_same(se2.exp(v), array(pose), atol=1e-6)
    np.testing.assert_allclose(se2.log(array(pose)), gtsam.Pose2.Logmap(pose), atol=1e-6)


@given(poses, tangents)
def test_adjoint_carries_tangents_across(a: FloatArray, v: FloatArray) -> None:
    right = se2.compose(a, se2.exp(v))
    left = se2.compose(se2.exp(se2.adjoint(a) @ v), a)
    if abs((se2.adjoint(a) @ v)[2]) < 3.1:
        assert_same(right, left, atol=1e-6)


@given(poses, st.lists(st.tuples(coordinates, coordinates), max_size=5))
def test_transform_agrees_with_gtsam(a: FloatArray, points: list[tuple[float, float]]) -> None:
    points_b = np.array(points).reshape(-1, 2)
    expected = [oracle(a).transformFrom(point) for point in points_b]
    np.testing.assert_allclose(se2.transform(a, points_b), np.array(expected).reshape(-1, 2), atol=1e-9)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_lie_in_the_half_open_turn(angle: float) -> None:
    wrapped = float(se2.wrap_angle(angle))
    assert -np.pi <= wrapped < np.pi + 1e-9
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_batches_equal_single_calls(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 7, 3)) * [5.0, 5.0, 3.0]
    points = rng.normal(size=(7, 4, 2))
    for function in (se2.compose, se2.between):
        assert_same(function(a, b), np.array([function(x, y) for x, y in zip(a, b, strict=True)]))
        assert_same(function(a[0], b), np.array([function(a[0], y) for y in b]))
    for of_one in (se2.inverse, se2.exp, se2.log):
        assert_same(of_one(a), np.array([of_one(x) for x in a]))
    np.testing.assert_allclose(se2.adjoint(a), [se2.adjoint(x) for x in a])
    np.testing.assert_allclose(
        se2.transform(a, points), [se2.transform(x, p) for x, p in zip(a, points, strict=True)]
    )
    assert se2.compose(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 3)


def covariance(rng: np.random.Generator, size: float) -> FloatArray:
    root = rng.normal(size=(3, 3)) * size
    return root @ root.T + 0.1 * size**2 * np.eye(3)


def test_body_covariance_in_world_axes_agrees_with_gtsam(rng: np.random.Generator) -> None:
    a, v = np.array([3.0, -2.0, 2.1]), covariance(rng, 1e-4)
    world = se2.body_to_world_covariance(v, a[2])
    samples = rng.multivariate_normal(np.zeros(3), v, size=20_000)
    moved = np.array([array(oracle(a).retract(sample)) for sample in samples[:2000]])
    # the perturbation's Jacobian, as the retraction of gtsam has it
    jacobian = np.eye(3)
    jacobian[:2, :2] = oracle(a).rotation().matrix()
    np.testing.assert_allclose(world, jacobian @ v @ jacobian.T, rtol=1e-12)
    np.testing.assert_allclose(np.cov((moved - a).T), world, atol=0.1 * world.max())
    np.testing.assert_allclose(
        se2.body_to_world_covariance(np.stack([v, v]), np.array([a[2], 0.0])), [world, v], rtol=1e-12
    )


def test_marginal_of_gtsam_is_the_compound_of_its_factors(rng: np.random.Generator) -> None:
    steps = [np.array([1.0, 0.2, 0.4]), np.array([0.5, -0.3, -1.1]), np.array([2.0, 0.0, 2.5])]
    covs = [covariance(rng, 0.05) for _ in range(4)]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    T, cov = np.array([1.0, 2.0, 0.5]), covs[0]
    graph.add(gtsam.PriorFactorPose2(0, oracle(T), gtsam.noiseModel.Gaussian.Covariance(cov)))
    values.insert(0, oracle(T))
    for i, (step, step_cov) in enumerate(zip(steps, covs[1:], strict=True)):
        noise = gtsam.noiseModel.Gaussian.Covariance(step_cov)
        graph.add(gtsam.BetweenFactorPose2(i, i + 1, oracle(step), noise))
        cov, T = se2.compound_covariance(cov, step, step_cov), se2.compose(T, step)
        values.insert(i + 1, oracle(T))
    marginal = gtsam.Marginals(graph, values).marginalCovariance(len(steps))
    np.testing.assert_allclose(cov, marginal, rtol=1e-6, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(), (0,), (3,), (2, 3)]), poses)
def test_compound_covariances_of_one_increment_equal_the_matrix_products(
    seed: int, shape: tuple[int, ...], step: FloatArray
) -> None:
    rng = np.random.default_rng(seed)
    covs, step_cov = rng.normal(size=(*shape, 3, 3)), rng.normal(size=(3, 3))  # symmetric or not
    A = oracle(step).inverse().AdjointMap()
    compound = se2.compound_covariance(covs, step, step_cov)
    assert compound.shape == (*shape, 3, 3)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(compound[index], A @ covs[index] @ A.T + step_cov, rtol=1e-9, atol=1e-9)


def test_three_covariances_compounded_at_once(rng: np.random.Generator) -> None:
    roots, step = rng.normal(size=(3, 3, 3)), np.array([0.3, -0.2, 1.1])
    covs, step_cov = roots @ roots.transpose(0, 2, 1), np.diag([0.01, 0.02, 0.03])
    out = np.empty((3, 3, 3))
    se2.compound_three(covs[0], covs[1], covs[2], step, step_cov, out)
    np.testing.assert_allclose(out, se2.compound_covariance(covs, step, step_cov), rtol=1e-12)


def test_compound_covariance_holds_by_monte_carlo(rng: np.random.Generator) -> None:
    T, step = np.array([1.0, 2.0, 0.5]), np.array([2.0, -1.0, 1.2])
    cov_a, cov_b = covariance(rng, 0.01), covariance(rng, 0.01)
    n = 40_000
    noisy_T = se2.compose(T[None], se2.exp(rng.multivariate_normal(np.zeros(3), cov_a, n)))
    noisy_step = se2.compose(step[None], se2.exp(rng.multivariate_normal(np.zeros(3), cov_b, n)))
    errors = se2.log(se2.between(se2.compose(T, step)[None], se2.compose(noisy_T, noisy_step)))
    expected = se2.compound_covariance(cov_a, step, cov_b)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.cov(errors.T) / scale, expected / scale, atol=0.03)
