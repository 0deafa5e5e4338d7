"""The moving-point test: an end point moves if its covariance ellipse covers free cells only."""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, PositiveShare, Share
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels, _kernels, _wide_kernels, reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.hit_memory import HitMemory
from slammot_graph.mapping.occupancy_grid import OccupancyGrid


@dataclass(frozen=True, kw_only=True)
class CommonModeConfig(Checked):
    """The test at the sigma points of a pose whose error is common to the scan.

    Attributes
    ----------
    consensus : float
        Share of the sigma points' weight at which a beam must be on free cells.
    """

    consensus: Share = 0.8


@dataclass(frozen=True, kw_only=True)
class EllipseTestConfig(Checked):
    """The test's beam noise and limits.

    Attributes
    ----------
    range_std_m, angle_std_rad : float
        R_l = diag(range_std^2, angle_std^2): noise of a beam (eq. 9).
    n_sigma : float
        Size of the ellipse; 2.448 holds 95% in two dimensions.
    max_cells : int
        An ellipse that spans more cells decides nothing.
    margin_cells : int or None
        Cells around the end point's own that must be free as well, whatever the ellipse: beams that graze a
        wall free its cells too. None: the ellipse alone decides, as in the paper.
    track_reach_m : float or None
        Beams on unknown cells, or too few for a cluster, move if a tracked object is expected this near; None: never.
    abstain_share : float
        If more than this share of the valid beams seems to move, none is called moving: a wrong pose looks
        just like that, and removing everything would lock the error in.
    common_mode : CommonModeConfig or None
        Treat the pose's error as common to the scan: test at its sigma points and take their consensus. Several times
        the work; with a matched pose it decides as the ellipse does, which alone is tested where this is None.
    """

    range_std_m: Positive = 0.01
    angle_std_rad: Positive = 0.005
    n_sigma: Positive = 2.448
    max_cells: Count = 10_000
    margin_cells: Count | None = 1
    track_reach_m: Positive | None = 0.4
    abstain_share: PositiveShare = 0.75
    common_mode: CommonModeConfig | None = None


def unpack_covariances(packed: FloatArray) -> FloatArray:
    """(n, 2, 2) matrices of (n, 3) rows xx, xy, yy."""
    return packed[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def end_point_covariances(
    scan: Scan, T_a_base: FloatArray, cov_pose: FloatArray, config: EllipseTestConfig
) -> FloatArray:
    """Covariance of each end point in frame a: ``H_r R_r H_r' + H_l R_l H_l'`` (eq. 9).

    Parameters
    ----------
    scan : Scan
        of n beams.
    T_a_base : (3,) array
    cov_pose : (3, 3) array
        R_r: covariance of the pose, right perturbation (body frame).

    Returns
    -------
    (n, 2, 2) array [m^2].
    """
    return unpack_covariances(packed_covariances(scan, T_a_base, cov_pose, config))


def packed_covariances(
    scan: Scan, T_a_base: FloatArray, cov_pose: FloatArray, config: EllipseTestConfig
) -> FloatArray:
    """(n, 3) rows xx, xy, yy [m^2] of `end_point_covariances`, whose parameters these are."""
    packed = np.empty((len(scan.ranges), 3))
    _kernels.end_point_covariances(
        scan.ranges,
        scan.directions_base,
        scan.origins_base,
        *_sweep(scan),
        float(T_a_base[2]),
        cov_pose,
        config.range_std_m,
        config.angle_std_rad,
        packed,
    )
    return packed


def detect_moving(
    scan: Scan,
    is_valid: BoolArray,
    T_a_base: FloatArray,
    cov_pose: FloatArray,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
    clusters: ClusterConfig,
    predicted_positions: FloatArray | None = None,
    vacated: FloatArray | None = None,
    vacated_reach_m: float = 0.5,
    hits: HitMemory | None = None,
    walks_along: BoolArray | None = None,
    mapped_share: float = 1.0,
    off_wall_m: float = math.inf,
) -> Detection:
    """Run the ellipse test on each beam of a scan, then keep what comes in clusters of a person's size.

    Parameters
    ----------
    scan : Scan
        of n beams.
    is_valid : (n,) bool array
    T_a_base : (3,) array
        Base in the grid's frame a.
    cov_pose : (3, 3) array
        Covariance of that pose, right perturbation (body frame).
    grid : OccupancyGrid
    predicted_positions : (k, 2) array, optional
        Where tracked objects should be now, frame a [m].
    vacated : (k, 2) array, optional
        Where something stood a moment ago that is gone, frame a [m].
    vacated_reach_m : float
        Beams on unknown cells move if they end this near to such a place.
    hits : HitMemory, optional
        What was hit before, frame a.
    walks_along : (n,) bool array, optional
        Beams that move though their cells are occupied or unknown, as `MatchResult.walks_along`.
    mapped_share, off_wall_m : float
        As of `RetestConfig`.
    """
    expected = _NOWHERE if predicted_positions is None else predicted_positions
    points, packed, reason = _test(scan, is_valid, T_a_base, cov_pose, grid, config)
    if config.common_mode is not None:
        consensus = config.common_mode.consensus
        reason = _test_at_sigma_points(scan, is_valid, T_a_base, cov_pose, grid, config, consensus)
    if walks_along is not None:
        is_along = walks_along & ((reason == reasons.OCCUPIED) | (reason == reasons.UNKNOWN))
        reason[is_along] = reasons.ALONG
    if hits is not None:
        hits.call_furniture(points, reason, clusters, expected, config.track_reach_m or 0.0)
    cluster, is_moving = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.bool_)
    n_clusters = _cluster_kernels.group_moving(
        points,
        is_valid,
        _NOWHERE if vacated is None else vacated,
        vacated_reach_m,
        expected,
        config.track_reach_m or 0.0,
        config.abstain_share,
        *clusters.kernel_arguments(),
        reason,
        cluster,
        is_moving,
    )
    if mapped_share < 1.0:
        _wide_kernels.mark_wide(
            *grid.cells,
            grid.l_occupied,
            points,
            is_valid,
            mapped_share,
            off_wall_m,
            clusters.max_gap_m,
            clusters.max_skipped_beams,
            clusters.max_x_range_m,
            clusters.max_y_range_m,
            reason,
        )
    return Detection(
        is_moving=is_moving, reason=reason, cluster=cluster, n_clusters=n_clusters, packed_cov=packed
    )


_NOWHERE: FloatArray = np.empty((0, 2))


def _test(
    scan: Scan,
    is_valid: BoolArray,
    T_a_base: FloatArray,
    cov_pose: FloatArray,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """End points (n, 2), their packed covariances (n, 3), and reasons (n,): what the cells under each ellipse say."""
    n = len(is_valid)
    points, packed, reason = np.empty((n, 2)), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    _kernels.test_beams(
        *grid.cells,
        grid.l_free,
        grid.l_occupied,
        scan.points_base(),
        scan.ranges,
        scan.directions_base,
        scan.origins_base,
        *_sweep(scan),
        is_valid,
        T_a_base,
        cov_pose,
        config.range_std_m,
        config.angle_std_rad,
        config.n_sigma,
        config.max_cells,
        config.margin_cells or 0,
        points,
        packed,
        reason,
    )
    return points, packed, reason


def _sweep(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Beam times (n,) and covariance (3, 3) of the velocity of a deskewed scan; times (0,) of any other."""
    if scan.sweep is None or scan.beam_times is None:
        return _AT_ONCE
    return scan.beam_times, scan.sweep.cov_velocity


_AT_ONCE: tuple[FloatArray, FloatArray] = np.empty(0), np.zeros((3, 3))


def _test_at_sigma_points(
    scan: Scan,
    is_valid: BoolArray,
    T_a_base: FloatArray,
    cov_pose: FloatArray,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
    consensus: float,
) -> IntArray:
    """(n,) reasons where the pose's error is common to the whole scan: by consensus over its sigma points.

    Each sigma point is a pose at which the test is made with the beams' own noise alone. It weighs the more the more
    beams end on occupied cells there; a beam is on free cells if it is so at most of the weight.
    """
    offsets = np.sqrt(3.0) * np.linalg.cholesky(cov_pose).T
    poses = se2.compose(T_a_base[None, :], se2.exp(np.vstack([np.zeros((1, 3)), offsets, -offsets])))
    exact = np.zeros((3, 3))
    reason_at = np.array([_test(scan, is_valid, T, exact, grid, config)[2] for T in poses])
    n_hits = np.count_nonzero(reason_at == reasons.OCCUPIED, axis=1)
    weights = np.exp((n_hits - n_hits.max()) / max(0.02 * np.count_nonzero(is_valid), 1.0))
    is_free = (weights @ (reason_at == reasons.FREE)) > consensus * weights.sum()
    best = reason_at[np.argmax(n_hits)]
    return np.where(is_free, reasons.FREE, np.where(best == reasons.FREE, reasons.UNKNOWN, best))
