"""The moving-point test: an end point moves if its covariance ellipse covers free cells only."""

from dataclasses import dataclass, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels, _kernels, reasons
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.mapping.occupancy_grid import OccupancyGrid

CONSENSUS = 0.8
"""Share of the sigma points' weight at which a beam must be on free cells."""


@dataclass(frozen=True, kw_only=True)
class EllipseTestConfig:
    """The test's beam noise and limits.

    Attributes
    ----------
    range_std_m, angle_std_rad : float
        R_l = diag(range_std^2, angle_std^2): noise of a beam (eq. 9).
    n_sigma : float
        Size of the ellipse; 2.448 holds 95% in two dimensions.
    max_cells : int
        An ellipse that spans more cells decides nothing.
    margin_cells : int
        Cells around the end point's own that must be free as well, whatever the ellipse: beams that graze a
        wall free its cells too. 0 in the paper.
    track_reach_m : float
        Beams on unknown cells, or too few for a cluster, move if a tracked object is expected this near; 0: never.
    stand_back_share : float
        If more than this share of the valid beams seems to move, none is called moving: a wrong pose looks
        just like that, and removing everything would lock the error in.
    abstain_nis : float
        None is called moving either after a match whose normalised innovation squared is above this.
    is_common_mode : bool
        Treat the pose's error as common to the scan: test at its sigma points and take their consensus. Several times
        the work; with a matched pose it decides as the ellipse does.
    """

    range_std_m: float = 0.01
    angle_std_rad: float = 0.005
    n_sigma: float = 2.448
    max_cells: int = 10_000
    margin_cells: int = 1
    track_reach_m: float = 0.4
    stand_back_share: float = 0.75
    abstain_nis: float = 50.0
    is_common_mode: bool = False

    def __post_init__(self) -> None:
        if not (self.range_std_m > 0.0 and self.angle_std_rad > 0.0):
            raise ConfigError("motion.range_std_m and motion.angle_std_rad must be positive")
        if not self.n_sigma > 0.0:
            raise ConfigError(f"motion.n_sigma must be positive, not {self.n_sigma}")
        if self.max_cells < 1:
            raise ConfigError(f"motion.max_cells must be at least 1, not {self.max_cells}")
        if self.margin_cells < 0:
            raise ConfigError(f"motion.margin_cells must not be negative, not {self.margin_cells}")
        if not self.track_reach_m >= 0.0:
            raise ConfigError(f"motion.track_reach_m must not be negative, not {self.track_reach_m}")
        if not self.abstain_nis > 0.0:
            raise ConfigError(f"motion.abstain_nis must be positive, not {self.abstain_nis}")
        if not 0.0 < self.stand_back_share <= 1.0:
            raise ConfigError(f"motion.stand_back_share must be in (0, 1], not {self.stand_back_share}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Detection:
    """Labels of one scan; every array has one entry a beam.

    Attributes
    ----------
    is_moving : (n,) bool array
    reason : (n,) int array
        Index into `motion.REASONS`.
    cluster : (n,) int array
        Number of the cluster of a moving beam, -1 for others.
    n_clusters : int
    packed_cov : (n, 3) array [m^2]
        Covariance of the end points in the frame of the pose: xx, xy, yy.
    """

    is_moving: BoolArray
    reason: IntArray
    cluster: IntArray
    n_clusters: int
    packed_cov: FloatArray

    def clusters(self, points: FloatArray) -> tuple[FloatArray, FloatArray, list[IntArray], BoolArray]:
        """Give what a tracker needs of the k clusters, with the scan's points (n, 2) in the frame of the pose.

        Returns centres (k, 2), their covariances (k, 2, 2), the beams of each, and whether free cells prove it (k,).
        """
        k = self.n_clusters
        centres, covs, is_proven = np.empty((k, 2)), np.empty((k, 2, 2)), np.empty(k, dtype=np.bool_)
        starts, beams = np.empty(k + 1, dtype=np.int64), np.empty(len(points), dtype=np.int64)
        if k:
            _cluster_kernels.cluster_moments(
                points, self.packed_cov, self.cluster, self.reason, centres, covs, is_proven, starts, beams
            )
        return centres, covs, [beams[starts[c] : starts[c + 1]] for c in range(k)], is_proven

    @classmethod
    def nothing(cls, is_valid: BoolArray) -> "Detection":
        """Call every beam of a scan static, as a method without a moving-point test does."""
        n = len(is_valid)
        return cls(
            is_moving=np.zeros(n, dtype=np.bool_),
            reason=np.where(is_valid, reasons.NOT_TESTED, reasons.NOT_VALID),
            cluster=np.full(n, -1),
            n_clusters=0,
            packed_cov=np.zeros((n, 3)),
        )

    def abstain(self) -> "Detection":
        """Take back what was called moving."""
        return replace(
            self,
            is_moving=np.zeros_like(self.is_moving),
            reason=np.where(self.is_moving, reasons.STOOD_BACK, self.reason),
            cluster=np.full_like(self.cluster, -1),
            n_clusters=0,
        )


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
    packed = np.empty((len(scan.ranges), 3))
    _kernels.end_point_covariances(
        scan.ranges,
        scan.laser.directions_base,
        scan.laser.origin_base,
        float(T_a_base[2]),
        cov_pose,
        config.range_std_m,
        config.angle_std_rad,
        packed,
    )
    return unpack_covariances(packed)


def detect_moving(
    scan: Scan,
    is_valid: BoolArray,
    T_a_base: FloatArray,
    cov_pose: FloatArray,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
    clusters: ClusterConfig,
    expected: FloatArray | None = None,
    vacated: FloatArray | None = None,
    emptied_reach_m: float = 0.5,
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
    expected : (k, 2) array, optional
        Where tracked objects should be now, frame a [m].
    vacated : (k, 2) array, optional
        Where something stood a moment ago that is gone, frame a [m].
    emptied_reach_m : float
        Beams on unknown cells move if they end this near to such a place.
    """
    points, packed, reason = _test(scan, is_valid, T_a_base, cov_pose, grid, config)
    if config.is_common_mode:
        reason = _test_at_sigma_points(scan, is_valid, T_a_base, cov_pose, grid, config)
    cluster, is_moving = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.bool_)
    n_clusters = _cluster_kernels.group_moving(
        points,
        is_valid,
        _NOWHERE if vacated is None else vacated,
        emptied_reach_m,
        _NOWHERE if expected is None else expected,
        config.track_reach_m,
        config.stand_back_share,
        clusters.max_gap_m,
        clusters.max_skipped_beams,
        clusters.min_points,
        clusters.max_x_range_m,
        clusters.max_y_range_m,
        clusters.split_gap_m,
        clusters.split_min_points,
        reason,
        cluster,
        is_moving,
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
        grid.log_odds,
        grid.stamp,
        grid.row0,
        grid.col0,
        grid.config.resolution_m,
        grid.oldest,
        not grid.is_rolling,
        grid.l_free,
        grid.l_occupied,
        scan.points_base(),
        scan.ranges,
        scan.laser.directions_base,
        scan.laser.origin_base,
        is_valid,
        T_a_base,
        cov_pose,
        config.range_std_m,
        config.angle_std_rad,
        config.n_sigma,
        config.max_cells,
        config.margin_cells,
        points,
        packed,
        reason,
    )
    return points, packed, reason


def _test_at_sigma_points(
    scan: Scan,
    is_valid: BoolArray,
    T_a_base: FloatArray,
    cov_pose: FloatArray,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
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
    is_free = (weights @ (reason_at == reasons.FREE)) > CONSENSUS * weights.sum()
    best = reason_at[np.argmax(n_hits)]
    return np.where(is_free, reasons.FREE, np.where(best == reasons.FREE, reasons.UNKNOWN, best))
