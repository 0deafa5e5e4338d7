"""Local maps of keyframes, pairs on them and the plain twin of their scatter, for the tests of covariances."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.registration.point_to_line import PointToLineConfig
from tests.rooms import LASER, ROOM, take_scan

A = np.array([2.0, 0.0, 1.7])
CONFIG = PointToLineConfig()
BEAM_STD_M = 0.018


def local_map_of(
    poses: FloatArray,
    rng: np.random.Generator | None = None,
    *,
    walls: FloatArray = ROOM,
    errors: FloatArray | None = None,
    covs: FloatArray | None = None,
    beam_std_m: float = BEAM_STD_M,
    max_range: float = np.inf,
) -> LocalMap:
    """Keyframes at true poses (k, 3) in the world, which is the local frame too; `errors` (k, 3) misplace them."""
    local_map = LocalMap(LocalMapConfig())
    for k, pose in enumerate(poses):
        noise = None if rng is None else rng.normal(0.0, beam_std_m, LASER.n_beams)
        scan = take_scan(pose, walls=walls, noise=noise)
        T = pose if errors is None else se2.compose(pose, se2.exp(errors[k]))
        keyframe = make_keyframe(k, T, scan.points_base(), scan.is_valid(max_range), LASER, local_map.config)
        local_map.add(keyframe, None if covs is None else covs[k])
    return local_map


def circle(n: int, step: tuple[float, float, float] = (0.3, 0.0, 0.15)) -> FloatArray:
    """Keyframes on the robot's path up to `A`."""
    poses = [A]
    for _ in range(n - 1):
        poses.append(se2.compose(poses[-1], se2.inverse(np.array(step))))
    return np.array(poses[::-1])


def random_cov(rng: np.random.Generator, std: tuple[float, float, float] = (0.02, 0.02, 0.01)) -> FloatArray:
    root = rng.normal(size=(3, 3)) * np.array(std)[:, None]
    return np.asarray(root @ root.T)


def close(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9 * max(np.abs(b).max(), 1e-30))


@dataclass
class Pairs:
    """Rows of the linearised residuals: (n, 3), with weight, map point, and whether they are on a line."""

    rows: FloatArray
    weights: FloatArray
    numbers: FloatArray
    is_line: BoolArray


def pairs_of(scan: Scan, local_map: LocalMap, T: FloatArray, max_range: float = np.inf) -> Pairs:
    """Each point's partner and its rows, one by one; the map's points as the kernel finds them."""
    R, mask = se2.rotation(T[2]), local_map.nearest.shape[0] - 1
    laser = se2.transform(T, LASER.origin_base[None])[0]
    rows, weights, numbers, is_line = [], [], [], []
    for p in scan.points_base()[scan.is_valid(max_range)]:
        q = T[:2] + R @ p
        column, row = np.floor(q / local_map.config.cell_m).astype(int)
        m = local_map.nearest[row & mask, column & mask]
        if m < local_map.first:
            continue
        offset, n = q - local_map.points[m], local_map.normals[m]
        if np.linalg.norm(offset) > local_map.config.reach_m:
            continue
        J = R @ np.array([[1.0, 0.0, -p[1]], [0.0, 1.0, p[0]]])  # of q
        s2 = CONFIG.kernel_scale_m**2
        if not n.any():
            w = CONFIG.point_weight * (s2 / (s2 + offset @ offset)) ** 2
            rows += [J[0], J[1]]
            weights += [w, w]
            numbers += [m, m]
            is_line += [False, False]
        elif n @ (laser - local_map.points[m]) >= 0.0:
            rows.append(n @ J)
            weights.append((s2 / (s2 + (n @ offset) ** 2)) ** 2)
            numbers.append(m)
            is_line.append(True)
    return Pairs(np.array(rows), np.array(weights), np.array(numbers), np.array(is_line))


def lines_of(pairs: Pairs, local_map: LocalMap) -> list[list[int]]:
    """Which pairs are on one line: each follows the one before on a line."""
    lines: list[list[int]] = []
    for k in np.flatnonzero(pairs.is_line):
        m = pairs.numbers[k]
        if lines:
            last = pairs.numbers[lines[-1][-1]]
            n = local_map.normals[last]
            off = n @ (local_map.points[m] - local_map.points[last])
            if n @ local_map.normals[m] > 0.95 and abs(off) < CONFIG.line_gap_m:
                lines[-1].append(int(k))
                continue
        lines.append([int(k)])
    return lines


def scatter_twin(pairs: Pairs, local_map: LocalMap, T: FloatArray) -> tuple[FloatArray, ...]:
    weighted = pairs.weights[:, None] * pairs.rows
    of_lines = np.array([weighted[line].sum(axis=0) for line in lines_of(pairs, local_map)])
    moved, by_keyframe = np.zeros((3, 3)), []
    for k, (T_keyframe, root) in enumerate(
        zip(local_map.T_local_keyframes, local_map.keyframe_roots, strict=True)
    ):
        own = local_map.owner[pairs.numbers] == k
        by_keyframe.append(weighted[own].T @ pairs.rows[own])
        T_base_keyframe = se2.between(T, T_keyframe)
        axes = np.eye(3)
        axes[:2, :2] = se2.rotation(T_keyframe[2])  # one error for all, in the axes of the local frame
        moved += by_keyframe[-1] @ se2.adjoint(T_base_keyframe) @ root @ axes.T
    return weighted.T @ weighted, of_lines.T @ of_lines, moved @ moved.T, np.array(by_keyframe)
