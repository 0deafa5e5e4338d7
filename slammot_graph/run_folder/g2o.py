"""``graph.g2o``: the pose graph, numbers in full precision."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.run_folder.atomic import write_text


def write_graph(path: Path, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
    """Write nodes (m, 3) as ``VERTEX_SE2`` and edges as ``EDGE_SE2`` with the upper triangle of the information.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_text(path, _lines(nodes, edges))


def _lines(nodes: FloatArray, edges: Sequence[GraphEdge]) -> Iterator[str]:
    upper = np.triu_indices(3)
    for number, pose in enumerate(nodes.tolist()):
        yield f"VERTEX_SE2 {number} {_numbers(pose)}"
    for edge in edges:
        numbers = [*edge.T_from_to.tolist(), *edge.information[upper].tolist()]
        yield f"EDGE_SE2 {edge.from_node} {edge.to_node} {_numbers(numbers)}"


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
