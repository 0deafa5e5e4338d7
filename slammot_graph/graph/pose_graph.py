"""The pose graph on GTSAM's ISAM2: odometry factors with R_r, match factors, marginal covariances.

The only importer of gtsam. Every call into gtsam is made in one thread with a large stack, since its
recursions over long chains overflow a default one.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from typing import TypeVar

import gtsam
import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Positive
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.linalg import eigh3, is_covariance
from slammot_graph.core.results import EdgeKind, GraphEdge
from slammot_graph.core.types import FloatArray

T = TypeVar("T")

STACK_BYTES = 256 << 20

_N_STEPS_ANEW = 10  # of Gauss and Newton, from poses that may have been shifted by what is taken back


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


class PoseGraph:
    """Nodes are poses of the base in the map, numbered from 0; edges are relative poses with information.

    Attributes
    ----------
    edges : list of GraphEdge
    dropped : list of (GraphEdge, str)
        Edges that could not be taken in, and why; whoever tells of them empties it.
    """

    def __init__(self, config: PoseGraphConfig) -> None:
        self.config = config
        self.edges: list[GraphEdge] = []
        self.dropped: list[tuple[GraphEdge, str]] = []
        self._n_nodes = 0
        self._waiting: list[GraphEdge] = []
        self._factor_of: dict[int, int] = {}
        self._poses: FloatArray | None = None
        self._snapshot: PoseGraph | None = None
        self._isam = _smoother(config)
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._thread = _large_stack_thread()

    def __len__(self) -> int:
        return self._n_nodes

    def start(self, T_map_base: FloatArray) -> int:
        """Add the first node, held by the prior; returns its number, 0."""
        self._add_prior(T_map_base)
        self._n_nodes = 1
        self.update()
        return 0

    def add_node(self, T_map_base: FloatArray) -> int:
        """Add a node with a first guess of its pose (3,); it needs an edge before the next `update` or question.

        Raises
        ------
        SlammotError
            The guess is not finite.
        """
        node = self._n_nodes
        if not np.isfinite(T_map_base).all():
            raise SlammotError(f"the pose of node {node} is not finite")
        self._snapshot = None
        self._new_values.insert(node, _pose(T_map_base))
        self._n_nodes += 1
        return node

    def add_edge(
        self, kind: EdgeKind, from_node: int, to_node: int, T_from_to: FloatArray, information: FloatArray
    ) -> GraphEdge:
        """Add a relative pose between two nodes; it counts from the next `update` or question on.

        Parameters
        ----------
        kind : "odometry", "match" or "closure"
        from_node, to_node : int
        T_from_to : (3,) array
        information : (3, 3) array
            Right perturbation (body frame of `to_node`), order (x, y, theta); may be rank-deficient.

        Raises
        ------
        SlammotError
            The measurement or its information is not finite, symmetric and positive semi-definite.
        """
        edge = GraphEdge(
            kind=kind, from_node=from_node, to_node=to_node, T_from_to=T_from_to, information=information
        )
        self._add_factor(edge)
        self.edges.append(edge)
        return edge

    def try_edge(
        self, kind: EdgeKind, from_node: int, to_node: int, T_from_to: FloatArray, information: FloatArray
    ) -> GraphEdge | None:
        """Add a relative pose as `add_edge` does; one that must not enter is noted in `dropped`, and None given."""
        try:
            return self.add_edge(kind, from_node, to_node, T_from_to, information)
        except SlammotError as error:
            edge = GraphEdge(
                kind=kind, from_node=from_node, to_node=to_node, T_from_to=T_from_to, information=information
            )
            self.dropped.append((edge, str(error)))
            return None

    def update(self) -> None:
        """Bring what was added into the smoother; every question below does so first.

        Where the smoother fails on it, it goes on without the new closures, or else without the new matches too: these
        are noted in `dropped`.

        Raises
        ------
        SlammotError
            The graph cannot be solved, as when a node has no edge; it is of no use from then on.
        """
        if self._new_factors.size() == 0 and self._new_values.size() == 0:
            return
        self._poses = None
        values = self._new_values
        try:
            result = self._take_in_new()
        except SlammotError as error:
            self._roll_back(values, error)
            return
        self._number_factors(result)

    def _take_in_new(self) -> gtsam.ISAM2Result:
        factors, values = self._new_factors, self._new_values
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        return self._in_thread(lambda: self._isam.update(factors, values))

    def _number_factors(self, result: gtsam.ISAM2Result) -> None:
        indices = list(result.getNewFactorsIndices())
        for edge, index in zip(self._waiting, indices[len(indices) - len(self._waiting) :], strict=True):
            if edge.kind == "closure":
                self._factor_of[id(edge)] = int(index)
        self._waiting = []

    def _roll_back(self, new: gtsam.Values, error: SlammotError) -> None:
        """Solve the graph anew without what the smoother has just failed on."""
        poses = self._poses_after_failure(new)
        waiting, edges = self._waiting, self.edges
        for kinds in (("closure",), ("closure", "match")):
            gone = {id(edge): edge for edge in waiting if edge.kind in kinds}
            if not gone:
                continue
            self.edges = [edge for edge in edges if id(edge) not in gone]
            try:
                self._begin_anew(poses)
                self._number_factors(self._take_in_new())
                for _ in range(_N_STEPS_ANEW):
                    self._in_thread(self._isam.update)
            except SlammotError:
                continue
            self.dropped += [(edge, str(error)) for edge in gone.values()]
            return
        self.edges = edges
        raise error

    def _poses_after_failure(self, new: gtsam.Values) -> FloatArray:
        """(n, 3) poses to begin with again: what the smoother still knows, first guesses, or along the odometry."""
        poses = np.zeros((self._n_nodes, 3))
        is_known = np.zeros(self._n_nodes, dtype=np.bool_)
        try:
            known = self._in_thread(self._isam.calculateEstimate)
        except SlammotError:
            known = gtsam.Values()
        for node in range(self._n_nodes):
            values = known if known.exists(node) else new
            if values.exists(node):
                poses[node] = _plain(values.atPose2(node))
                is_known[node] = np.isfinite(poses[node]).all()
        for edge in self.edges:
            if edge.kind == "odometry" and not is_known[edge.to_node]:
                poses[edge.to_node] = se2.compose(poses[edge.from_node], edge.T_from_to)
        return poses

    def remove_edges(self, edges: Sequence[GraphEdge]) -> None:
        """Take edges of kind "closure" out again, which turned out wrong."""
        self.update()
        self._poses = self._snapshot = None

        def remove() -> None:
            parameters = gtsam.ISAM2UpdateParams()
            known = [id(edge) for edge in edges if id(edge) in self._factor_of]
            parameters.removeFactorIndices = [self._factor_of.pop(one) for one in known]
            self._isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), parameters)
            for _ in range(2):
                self._isam.update()

        self._in_thread(remove)
        gone = {id(edge) for edge in edges}
        self.edges = [edge for edge in self.edges if id(edge) not in gone]

    def load(self, poses: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Begin with the nodes (n, 3) and edges of a saved graph."""
        self.edges, self._n_nodes = list(edges), len(poses)
        self.rebuild(poses)

    def rebuild(self, poses: FloatArray) -> None:
        """Solve the whole graph anew from these poses (n, 3), as when a component of it turns out to lie elsewhere.

        Edges that wait for the next `update` come in as well.
        """
        self._begin_anew(poses)
        self.update()
        self._in_thread(self._isam.update)
        self._poses = None

    def _begin_anew(self, poses: FloatArray) -> None:
        """Let the prior, nodes at these poses and all edges wait for a new smoother."""
        self._isam = _smoother(self.config)
        self._snapshot = self._poses = None
        self._factor_of, self._waiting = {}, []
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._add_prior(poses[0])
        for node, pose in enumerate(poses[1:], start=1):
            self._new_values.insert(node, _pose(pose))
        for edge in self.edges:
            self._add_factor(edge)

    def pose(self, node: int) -> FloatArray:
        """(3,) optimised pose of a node, map frame."""
        self.update()
        return self._in_thread(lambda: _plain(self._isam.calculateEstimatePose2(node)))

    def poses(self) -> FloatArray:
        """(n, 3) optimised poses of all nodes, map frame."""
        self.update()
        if self._poses is None:
            values = self._in_thread(self._isam.calculateBestEstimate)
            poses = np.asarray(gtsam.utilities.extractPose2(values), dtype=np.float64)
            self._poses = poses.reshape(-1, 3)
        return self._poses.copy()

    def snapshot(self) -> "PoseGraph":
        """Copy the graph, to ask the copy what the estimate must not depend on; only questions, and do not close it.

        A question to the graph itself brings what waits into the smoother and solves it in full, which shifts the
        points that nodes are linearised at later: the estimate would depend on who looked at it, and when. The copy's
        cost grows with the number of nodes; it is kept until the graph changes.

        Raises
        ------
        SlammotError
            The graph cannot be solved.
        """
        if self._snapshot is None:
            other = copy(self)
            other._isam = self._in_thread(lambda: gtsam.ISAM2(self._isam))
            other.edges, other._waiting, other.dropped = list(self.edges), list(self._waiting), []
            other._factor_of = dict(self._factor_of)
            other.update()
            self._snapshot = other
        return self._snapshot

    def marginal(self, node: int) -> FloatArray:
        """(3, 3) absolute covariance of a node, right perturbation (body frame)."""
        self.update()
        cov = np.asarray(self._in_thread(lambda: self._isam.marginalCovariance(node)), dtype=np.float64)
        return _checked(cov, f"node {node}")

    def marginals(self) -> FloatArray:
        """(n, 3, 3) absolute covariances of all nodes, right perturbation (body frame)."""
        self.update()

        def all_marginals() -> FloatArray:
            return np.array([self._isam.marginalCovariance(k) for k in range(self._n_nodes)])

        return self._in_thread(all_marginals)

    def relative_covariance(self, anchor: int, node: int) -> FloatArray:
        """(3, 3) covariance of a node relative to an anchor, right perturbation (body frame of `node`).

        From the joint marginal J of both: ``H J H'`` with ``H = [-Ad(T_node_anchor) | I]``.
        """
        if anchor == node:
            return np.zeros((3, 3))
        self.update()

        def query() -> tuple[FloatArray, gtsam.Pose2]:
            joint = self._isam.jointMarginalCovariance([anchor, node]).fullMatrix()
            T_anchor_node = self._isam.calculateEstimatePose2(anchor).between(
                self._isam.calculateEstimatePose2(node)
            )
            return np.asarray(joint, dtype=np.float64), T_anchor_node

        joint, T_anchor_node = self._in_thread(query)
        H = np.hstack([-T_anchor_node.inverse().AdjointMap(), np.eye(3)])
        return _checked(H @ joint @ H.T, f"node {node} relative to node {anchor}")

    def _add_prior(self, T_map_base: FloatArray) -> None:
        sigmas = np.array([self.config.prior_std_m, self.config.prior_std_m, self.config.prior_std_rad])
        pose = _pose(T_map_base)
        self._new_factors.add(gtsam.PriorFactorPose2(0, pose, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
        self._new_values.insert(0, pose)

    def _add_factor(self, edge: GraphEdge) -> None:
        noise = _noise(edge)
        self._snapshot = None
        between = gtsam.BetweenFactorPose2(edge.from_node, edge.to_node, _pose(edge.T_from_to), noise)
        self._new_factors.add(between)
        self._waiting.append(edge)

    def close(self) -> None:
        """End the graph's thread."""
        self._thread.shutdown(wait=True)

    def _in_thread(self, call: Callable[[], T]) -> T:
        try:
            return self._thread.submit(call).result()
        except (RuntimeError, IndexError, ValueError) as error:
            cause = next(iter(str(error).strip().splitlines()), type(error).__name__)
            raise SlammotError(
                f"the pose graph of {self._n_nodes} nodes cannot be solved: {cause}"
            ) from error


def _smoother(config: PoseGraphConfig) -> gtsam.ISAM2:
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


def _noise(edge: GraphEdge) -> gtsam.noiseModel.Gaussian:
    """Square-root information with a floor, since gtsam takes a rank-deficient matrix in silence."""
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
    root = np.sqrt(np.maximum(values, 1e-9 * largest))[:, None] * vectors.T
    return gtsam.noiseModel.Gaussian.SqrtInformation(root)


def _checked(cov: FloatArray, name: str) -> FloatArray:
    cov = 0.5 * (cov + cov.T)
    if not is_covariance(cov):
        raise SlammotError(f"the covariance of {name} is not positive definite: the graph is ill-posed there")
    return cov
