"""The pose graph: odometry factors with R_r, match factors, marginal covariances; solved by `smoother.py`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy, deepcopy
from typing import Any

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.linalg import is_covariance
from slammot_graph.core.results import EdgeKind, GraphEdge
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.graph.merged_nodes import MergedNodes
from slammot_graph.graph.smoother import PoseGraphConfig, Smoother, root_information

__all__ = ["PoseGraph", "PoseGraphConfig"]

_N_STEPS_ANEW = 10  # of Gauss and Newton, from poses that may have been shifted by what is taken back


class PoseGraph:
    """Nodes are poses of the base in the map, numbered from 0; edges are relative poses with information.

    Attributes
    ----------
    edges : list of GraphEdge
        Those that are solved for: of nodes that are not merged.
    dropped : list of (GraphEdge, str)
        Edges that could not be taken in, and why; whoever tells of them empties it.
    """

    def __init__(self, config: PoseGraphConfig) -> None:
        self.config = config
        self.edges: list[GraphEdge] = []
        self.dropped: list[tuple[GraphEdge, str]] = []
        self._n_nodes = 0
        self._prior: FloatArray | None = None
        self._waiting_nodes: list[tuple[int, FloatArray]] = []
        self._waiting: list[GraphEdge] = []
        self._factor_of: dict[GraphEdge, int] = {}
        self._poses: FloatArray | None = None
        self._snapshot: PoseGraph | None = None
        self._merged = MergedNodes()
        self._smoother = Smoother(config)

    def __len__(self) -> int:
        return self._n_nodes

    def __getstate__(self) -> dict[str, Any]:
        """Give all but the copy that is asked questions."""
        return {**self.__dict__, "_snapshot": None}

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the nodes."""
        return (self._smoother.asked.spool,)

    def start(self, T_map_base: FloatArray) -> int:
        """Add the first node, held by the prior; returns its number, 0."""
        self._prior = T_map_base.copy()
        self._waiting_nodes.append((0, T_map_base.copy()))
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
        self._waiting_nodes.append((node, T_map_base.copy()))
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
            The measurement or its information is not finite, symmetric and positive semi-definite; both nodes are
            merged into one.
        """
        if from_node in self._merged:
            from_node, T_onto_from = self._merged.place_of(from_node)
            T_from_to = se2.compose(T_onto_from, T_from_to)
        if to_node in self._merged:
            to_node, T_onto_to = self._merged.place_of(to_node)
            A = se2.adjoint(se2.inverse(T_onto_to))
            T_from_to, information = se2.compose(T_from_to, se2.inverse(T_onto_to)), A.T @ information @ A
        if from_node == to_node:
            raise SlammotError(f"{kind} edge {from_node}-{to_node} joins what lies firmly on one node")
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
        if self._prior is None and not self._waiting_nodes and not self._waiting:
            return
        self._poses = None
        nodes = self._waiting_nodes
        try:
            self._take_in_new()
        except SlammotError as error:
            self._roll_back(nodes, error)

    def _take_in_new(self) -> None:
        prior, nodes = self._prior, self._waiting_nodes
        self._prior, self._waiting_nodes = None, []
        with self._named():
            numbers = self._smoother.add(prior, nodes, self._waiting)
        self._factor_of.update(zip(self._waiting, numbers, strict=True))
        self._waiting = []

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Say which graph it is that the smoother cannot solve."""
        try:
            yield
        except SlammotError as error:
            raise SlammotError(f"the pose graph of {self._n_nodes} nodes {error}") from error.__cause__

    def _roll_back(self, new: Sequence[tuple[int, FloatArray]], error: SlammotError) -> None:
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
                self._take_in_new()
                for _ in range(_N_STEPS_ANEW):
                    self._smoother.iterate()
            except SlammotError:
                continue
            self.dropped += [(edge, str(error)) for edge in gone.values()]
            return
        self.edges = edges
        raise error

    def _poses_after_failure(self, new: Sequence[tuple[int, FloatArray]]) -> FloatArray:
        """(n, 3) poses to begin with again: what the smoother still knows, first guesses, or along the odometry."""
        poses = self._smoother.known_poses(self._n_nodes)
        for node, guess in new:
            if np.isnan(poses[node]).all():
                poses[node] = guess
        for edge in self.edges:
            if edge.kind == "odometry" and not np.isfinite(poses[edge.to_node]).all():
                poses[edge.to_node] = se2.compose(poses[edge.from_node], edge.T_from_to)
        return np.nan_to_num(poses, posinf=0.0, neginf=0.0)

    def remove_edges(self, edges: Sequence[GraphEdge]) -> None:
        """Take edges out again; each node must keep one that leads, over others, to the first node."""
        self.update()
        self._poses = self._snapshot = None
        known = [edge for edge in edges if edge in self._factor_of]
        with self._named():
            self._smoother.remove([self._factor_of.pop(edge) for edge in known])
            for _ in range(2):
                self._smoother.iterate()
        gone = {id(edge) for edge in edges}
        self.edges = [edge for edge in self.edges if id(edge) not in gone]

    def merge(self, nodes: Sequence[int], onto: int, cut: int) -> bool:
        """Merge nodes into another one: they lie to it from now on as they do now, and all of their edges go.

        What the edges told the rest of the graph is lost to it: its covariances grow.

        Parameters
        ----------
        nodes : sequence of int
            The first of them is tied to `onto` by a closure.
        onto : int
            Not merged itself.
        cut : int
            Edges from nodes before this one to it or a later one go as well, but for closures.

        Returns
        -------
        Whether it was done: nothing is where the covariances to `onto` cannot be told.
        """
        poses = self.poses() if nodes else np.empty((0, 3))
        try:
            relative = [
                (node, se2.between(poses[onto], poses[node]), self.relative_covariance(onto, node))
                for node in nodes
            ]
        except SlammotError:
            return False
        gone = set(nodes)
        self.remove_edges(
            [
                edge
                for edge in self.edges
                if edge.from_node in gone
                or edge.to_node in gone
                or (edge.kind != "closure" and edge.from_node < cut <= edge.to_node)
            ]
        )
        for node, T_onto_node, cov in relative:
            self._merged.add(node, onto, T_onto_node, cov, is_closure=node == nodes[0])
        return True

    @property
    def n_merged(self) -> int:
        """Nodes that are solved for no more."""
        return len(self._merged)

    @property
    def all_edges(self) -> tuple[GraphEdge, ...]:
        """All edges, with one for each merged node."""
        return (*self.edges, *self._merged.edges())

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
        with self._named():
            self._smoother.iterate()
        self._poses = None

    def _begin_anew(self, poses: FloatArray) -> None:
        """Let the prior, nodes at these poses and all edges wait for a new smoother."""
        self._smoother.begin_anew()
        self._snapshot = self._poses = None
        self._factor_of, self._waiting = {}, list(self.edges)
        self._prior = poses[0].copy()
        self._waiting_nodes = [(node, poses[node].copy()) for node in self._live().tolist()]

    def pose(self, node: int) -> FloatArray:
        """(3,) optimised pose of a node, map frame."""
        if node in self._merged:
            onto, T_onto_node = self._merged.place_of(node)
            return se2.compose(self.pose(onto), T_onto_node)
        self.update()
        with self._named():
            return self._smoother.pose(node)

    def poses(self) -> FloatArray:
        """(n, 3) optimised poses of all nodes, map frame."""
        self.update()
        if self._poses is None:
            self._poses = np.empty((self._n_nodes, 3))
            with self._named():
                self._poses[self._live()] = self._smoother.poses()
            self._merged.place(self._poses)
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
            other._smoother = self._smoother.copy()
            other.edges, other._waiting, other.dropped = list(self.edges), list(self._waiting), []
            other._waiting_nodes = list(self._waiting_nodes)
            other._factor_of = dict(self._factor_of)
            other._merged = deepcopy(self._merged)
            other.update()
            self._snapshot = other
        return self._snapshot

    def marginal(self, node: int) -> FloatArray:
        """(3, 3) absolute covariance of a node, right perturbation (body frame)."""
        self.update()
        with self._named():
            cov = self._smoother.marginal(node)
        return _checked(cov, f"node {node}")

    def marginals(self) -> FloatArray:
        """(n, 3, 3) absolute covariances of all nodes, right perturbation (body frame)."""
        self.update()
        covs, live = np.empty((self._n_nodes, 3, 3)), self._live()
        with self._named():
            covs[live] = self._smoother.marginals(live.tolist())
        self._merged.spread(covs)
        return covs

    def relative_covariance(self, anchor: int, node: int) -> FloatArray:
        """(3, 3) covariance of a node relative to an anchor, right perturbation (body frame of `node`)."""
        if anchor == node:
            return np.zeros((3, 3))
        self.update()
        with self._named():
            cov = self._smoother.relative_covariance(anchor, node)
        return _checked(cov, f"node {node} relative to node {anchor}")

    def _live(self) -> IntArray:
        """Nodes that are not merged, in their order."""
        return np.delete(np.arange(self._n_nodes), self._merged.nodes)

    def _add_factor(self, edge: GraphEdge) -> None:
        root_information(edge)  # refuses it before it waits
        self._snapshot = None
        self._waiting.append(edge)

    def close(self) -> None:
        """End the graph's thread."""
        self._smoother.close()


def _checked(cov: FloatArray, name: str) -> FloatArray:
    cov = 0.5 * (cov + cov.T)
    if not is_covariance(cov):
        raise SlammotError(f"the covariance of {name} is not positive definite: the graph is ill-posed there")
    return cov
