"""Kernel of the local factors: block covariances of a small linearised pose graph, without a linear-algebra library.

Libraries of that kind start threads for matrices of this size, which costs more than the sum.
"""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.linalg import invert_lower
from slammot_graph.core.types import FloatArray, IntArray


@kernel
def block_covariances(
    from_nodes: IntArray,
    to_nodes: IntArray,
    T_from_to: FloatArray,
    informations: FloatArray,
    out: FloatArray,
) -> bool:
    """Fill `out` (k, 3, 3) with the marginal covariances of the k nodes of a linearised pose graph.

    Parameters
    ----------
    from_nodes, to_nodes : (n,) int arrays
        The edges' nodes, from 0 to k - 1; -1 for a node that is held.
    T_from_to : (n, 3) array
    informations : (n, 3, 3) array
        Right perturbation (body frame of the edge's second node).

    Returns
    -------
    False where the graph does not determine its nodes.
    """
    size = 3 * out.shape[0]
    H = np.zeros((size, size))
    J = np.zeros((3, 3))  # of the first node: -Ad(inverse(T))
    J[2, 2] = -1.0
    IJ = np.empty((3, 3))
    for e in range(from_nodes.shape[0]):
        c = math.cos(T_from_to[e, 2])
        s = math.sin(T_from_to[e, 2])
        x = T_from_to[e, 0]
        y = T_from_to[e, 1]
        J[0, 0] = J[1, 1] = -c
        J[0, 1] = -s
        J[1, 0] = s
        J[0, 2] = c * y - s * x
        J[1, 2] = -s * y - c * x
        a = 3 * from_nodes[e]
        b = 3 * to_nodes[e]
        for i in range(3):
            for j in range(3):
                IJ[i, j] = 0.0
                for m in range(3):
                    IJ[i, j] += informations[e, i, m] * J[m, j]
                if b >= 0:
                    H[b + i, b + j] += informations[e, i, j]
        for i in range(3):
            for j in range(3):
                if a >= 0:
                    for m in range(3):
                        H[a + i, a + j] += J[m, i] * IJ[m, j]
                    if b >= 0:
                        H[b + i, a + j] += IJ[i, j]
                        H[a + j, b + i] += IJ[i, j]
    # Cholesky factor in the lower triangle, then its inverse
    for j in range(size):
        for i in range(j, size):
            rest = H[i, j]
            for m in range(j):
                rest -= H[i, m] * H[j, m]
            if i == j:
                if not rest > 0.0:
                    return False
                H[j, j] = math.sqrt(rest)
            else:
                H[i, j] = rest / H[j, j]
    inverse = np.zeros((size, size))
    invert_lower(H, inverse)
    for k in range(out.shape[0]):
        for i in range(3):
            for j in range(3):
                total = 0.0
                for m in range(3 * k + max(i, j), size):
                    total += inverse[m, 3 * k + i] * inverse[m, 3 * k + j]
                out[k, i, j] = total
    return True
