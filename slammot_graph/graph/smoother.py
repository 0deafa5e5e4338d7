"""ISAM2 in a thread of its own: plain poses and edges in, plain poses and covariances out.

The only importer of gtsam. Every call into gtsam is made in one thread with a large stack, since its recursions over
long chains overflow a default one.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import gtsam
import numpy as np

from slammot_graph.core.checks import Checked, Positive
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.linalg import eigh3
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.asked import Asked

T = TypeVar("T")

STACK_BYTES = 256 << 20


@dataclass(frozen=True, kw_only=True)
class PoseGraphConfig(Checked):
    """Settings of the incremental smoother.

    Attributes
    ----------
    prior_std_m, prior_std_rad : float
        Of the first node, which is where the map's frame lies.
    relinearize_threshold : float
        A node that moved by more than this [m, rad] is linearised again.
    """

    prior_std_m: Positive = 1e-4
    prior_std_rad: Positive = 1e-4
    relinearize_threshold: Positive = 0.02


class Smoother:
    """ISAM2, which notes everything it was asked that changes it: so its state can be kept and restored.

    Nothing of gtsam's inside can be written to a file. One that is asked for the same in the same order is the same,
    bit by bit: a smoother that is copied by `pickle` does it all again.

    Attributes
    ----------
    config : PoseGraphConfig
    asked : Asked
    """

    def __init__(self, config: PoseGraphConfig) -> None:
        self.config = config
        self._isam = _isam2(config)
        self.asked = Asked()
        self._has_changed = False
        self._thread = _large_stack_thread()

    def __getstate__(self) -> dict[str, Any]:
        """Give what it was asked."""
        return {"config": self.config, "asked": self.asked}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Do all of it again."""
        self.__init__(state["config"])  # type: ignore[misc]
        state["asked"].repeat(self)
        self.asked = state["asked"]

    def begin_anew(self) -> None:
        """Forget all."""
        self._isam = _isam2(self.config)
        self.asked.begin_anew()

    def copy(self) -> "Smoother":
        """Give another one that is asked questions only; it shares the thread."""
        other = Smoother.__new__(Smoother)
        other.__dict__.update(self.__dict__)
        other._isam = self._in_thread(lambda: gtsam.ISAM2(self._isam))
        other.asked = Asked()
        return other

    def add(
        self, prior: FloatArray | None, nodes: Sequence[tuple[int, FloatArray]], edges: Sequence[GraphEdge]
    ) -> list[int]:
        """Take in the prior of node 0, nodes with first guesses of their poses (3,), and edges.

        Returns
        -------
        The edges' numbers, for `remove`.

        Raises
        ------
        SlammotError
            The graph cannot be solved; it is of no use until `begin_anew`.
        """
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if prior is not None:
            sigmas = np.array([self.config.prior_std_m, self.config.prior_std_m, self.config.prior_std_rad])
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            factors.add(gtsam.PriorFactorPose2(0, _pose(prior), noise))
        for node, pose in nodes:
            values.insert(node, _pose(pose))
        for edge in edges:
            root = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(edge))
            factors.add(gtsam.BetweenFactorPose2(edge.from_node, edge.to_node, _pose(edge.T_from_to), root))
        self.asked.add(prior, nodes, edges)
        self._has_changed = True
        result = self._in_thread(lambda: self._isam.update(factors, values))
        numbers = [int(number) for number in result.getNewFactorsIndices()]
        return numbers[len(numbers) - len(edges) :]

    def remove(self, numbers: Sequence[int]) -> None:
        """Take edges out again, by the numbers that `add` gave."""
        parameters = gtsam.ISAM2UpdateParams()
        parameters.removeFactorIndices = list(numbers)
        self.asked.remove(numbers)
        self._has_changed = True
        self._in_thread(lambda: self._isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), parameters))

    def iterate(self) -> None:
        """Do one more step of Gauss and Newton, where nodes have moved far enough."""
        self.asked.iterate()
        self._has_changed = True
        self._in_thread(self._isam.update)

    def pose(self, node: int) -> FloatArray:
        """(3,) optimised pose of a node."""
        if self._has_changed:
            self.asked.pose(node)
            self._has_changed = False
        return self._in_thread(lambda: _plain(self._isam.calculateEstimatePose2(node)))

    def poses(self) -> FloatArray:
        """(n, 3) optimised poses of all nodes that have an edge, in their order, solved in full."""
        self.asked.poses()
        values = self._in_thread(self._isam.calculateBestEstimate)
        return np.asarray(gtsam.utilities.extractPose2(values), dtype=np.float64).reshape(-1, 3)

    def known_poses(self, n_nodes: int) -> FloatArray:
        """(n_nodes, 3) poses that it still knows after a failure; rows of NaN for others."""
        poses = np.full((n_nodes, 3), np.nan)
        try:
            values = self._in_thread(self._isam.calculateEstimate)
        except SlammotError:
            return poses
        for node in range(n_nodes):
            if values.exists(node):
                poses[node] = _plain(values.atPose2(node))
        return poses

    def marginal(self, node: int) -> FloatArray:
        """(3, 3) absolute covariance of a node, right perturbation (body frame)."""
        return np.asarray(self._in_thread(lambda: self._isam.marginalCovariance(node)), dtype=np.float64)

    def marginals(self, nodes: Sequence[int]) -> FloatArray:
        """(n, 3, 3) absolute covariances of nodes."""

        def all_marginals() -> FloatArray:
            return np.array([self._isam.marginalCovariance(k) for k in nodes])

        return self._in_thread(all_marginals)

    def relative_covariance(self, anchor: int, node: int) -> FloatArray:
        """(3, 3) covariance of a node relative to an anchor, right perturbation (body frame of `node`).

        From the joint marginal J of both: ``H J H'`` with ``H = [-Ad(T_node_anchor) | I]``.
        """
        if self._has_changed:
            self.asked.pose(anchor)
            self._has_changed = False

        def query() -> tuple[FloatArray, gtsam.Pose2]:
            joint = self._isam.jointMarginalCovariance([anchor, node]).fullMatrix()
            T_anchor_node = self._isam.calculateEstimatePose2(anchor).between(
                self._isam.calculateEstimatePose2(node)
            )
            return np.asarray(joint, dtype=np.float64), T_anchor_node

        joint, T_anchor_node = self._in_thread(query)
        H = np.hstack([-T_anchor_node.inverse().AdjointMap(), np.eye(3)])
        cov: FloatArray = H @ joint @ H.T
        return cov

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(wait=True)

    def _in_thread(self, call: Callable[[], T]) -> T:
        try:
            return self._thread.submit(call).result()
        except (RuntimeError, IndexError, ValueError) as error:
            cause = next(iter(str(error).strip().splitlines()), type(error).__name__)
            raise SlammotError(f"cannot be solved: {cause}") from error


def root_information(edge: GraphEdge) -> FloatArray:
    """(3, 3) square-root information of an edge with a floor, since gtsam takes a rank-deficient matrix in silence.

    Raises
    ------
    SlammotError
        The measurement or its information is not finite, symmetric and positive semi-definite.
    """
    name = f"{edge.kind} edge {edge.from_node}-{edge.to_node}"
    if not (np.isfinite(edge.T_from_to).all() and np.isfinite(edge.information).all()):
        raise SlammotError(f"{name} is not finite")
    a, b = edge.information, edge.information.T
    if (np.abs(a - b) > 1e-8 + 1e-6 * np.abs(b)).any():
        raise SlammotError(f"the information of {name} is not symmetric")
    values, vectors = np.empty(3), np.empty((3, 3))
    eigh3(edge.information, values, vectors)
    largest = values.max()
    if not largest > 0.0 or values.min() < -1e-6 * largest:
        raise SlammotError(f"the information of {name} is not positive semi-definite")
    root: FloatArray = np.sqrt(np.maximum(values, 1e-9 * largest))[:, None] * vectors.T
    return root


def _isam2(config: PoseGraphConfig) -> gtsam.ISAM2:
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    parameters.setRelinearizeThreshold(config.relinearize_threshold)
    parameters.relinearizeSkip = 1
    parameters.enablePartialRelinearizationCheck = True
    return gtsam.ISAM2(parameters)


def _large_stack_thread() -> ThreadPoolExecutor:
    """One worker thread with a stack of `STACK_BYTES`, started now so that no other thread gets it."""
    before = threading.stack_size(STACK_BYTES)
    try:
        executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="pose-graph")
        executor.submit(int).result()
    finally:
        threading.stack_size(before)
    return executor


def _pose(T_a_b: FloatArray) -> gtsam.Pose2:
    return gtsam.Pose2(float(T_a_b[0]), float(T_a_b[1]), float(T_a_b[2]))


def _plain(pose: gtsam.Pose2) -> FloatArray:
    return np.array([pose.x(), pose.y(), pose.theta()])
