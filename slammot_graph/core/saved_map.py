"""``map.slam``: a map that later runs start from, as plain arrays; what the file looks like, and how it is read.

The file begins with one line of ASCII, ``slammot-graph map VERSION SHA256``, the checksum being that of all bytes after
the line. These are an ``.npz`` archive (zip of ``.npy`` arrays, no pickle):

- ``header``: bytes of a JSON object with ``runs`` (a list of `SavedRun`), ``joined`` and ``edits``.
- ``nodes`` (m, 3), ``node_scans`` (m,); ``edge_kinds`` (e,) an index into `EDGE_KINDS`, ``edge_nodes`` (e, 2),
  ``edge_poses`` (e, 3), ``edge_informations`` (e, 6): the upper triangle, row by row; ``odometry_errors`` (m, 12),
  which files of 0.2.0 do not have.
- ``keyframe_nodes`` (k,), ``keyframe_poses`` (k, 3), ``keyframe_lasers`` (k,), ``keyframe_origins`` (k, 2),
  ``keyframe_sizes`` (k,), ``keyframe_units`` (k,): of a keyframe's points the next ``sizes`` rows of ``points`` (p, 2),
  int16 in ``units`` metres, and of ``normals`` (p,), int16: the direction in 1/10000 rad, -32768 for none.
- ``submap_sizes`` (s,), ``submap_keyframes``: the numbers of their keyframes, one submap after the other;
  ``submap_paths`` (s,) [m], ``submap_components`` (s,).
"""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self, get_args

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import check_regular
from slammot_graph.core.number_rows import MOST_SENSIBLE
from slammot_graph.core.results import EdgeKind, GraphEdge
from slammot_graph.core.types import FloatArray, IntArray

MAP_FILE = "map.slam"
VERSION = 1
EDGE_KINDS: tuple[EdgeKind, ...] = get_args(EdgeKind)

_MAGIC = b"slammot-graph map"
_MOST_BYTES = 1 << 30
_UPPER = np.triu_indices(3)
_NO_NORMAL = -32768


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """A run that went into the map.

    Attributes
    ----------
    log : str
        Name of its log; empty where there was none.
    first_node, component : int
        Where it begins: its first node, and the component of the graph that this began.
    first_scan : int
        Which line of the folder's ``trajectory.tum``, from 0, is that of its first scan; -1: it is not there.
    odometry : mapping of str to (float, float)
        What the run found out about its odometry: each number of `OdometryReport` with its standard deviation; without
        those that the drive does not tell.
    """

    log: str = ""
    first_node: int = 0
    component: int = 0
    first_scan: int = 0
    odometry: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedMap:
    """Local maps and pose graph of one or several runs: m nodes, k keyframes, s local maps.

    Attributes
    ----------
    nodes : (m, 3) array
        Optimised poses, map frame.
    node_scans : (m,) int array
        Scan of each, of the run that it belongs to.
    edges : tuple of GraphEdge
    keyframe_nodes : (k,) int array
        Node of each keyframe, -1 for none.
    keyframe_poses : (k, 3) array
        Where the matches placed it, in a frame that the keyframes of one local map share.
    keyframe_lasers : (k,) int array
        Which laser.
    keyframe_origins : (k, 2) array
        Where the laser was, base frame [m].
    keyframe_sizes : (k,) int array
        How many points each has.
    points, normals : (p, 2) arrays
        Of one keyframe after the other, base frame [m]; a normal of (0, 0) on no line.
    submaps : tuple of int arrays
        The keyframes of each local map; the first one is the anchor, and has a node.
    submap_paths : (s,) array
        Length of the path up to each [m].
    submap_components : (s,) int array
        Component of the graph.
    joined : tuple of int
        Components whose place in the map is known.
    runs : tuple of SavedRun
    odometry_errors : (m, 3, 4) array
        Of the odometry's edge that leads to each node, by one standard deviation of each parameter that all edges of
        its run have in common (`graph.common_errors`); zero for none.
    edits : tuple of str
        What was changed in it by hand, in the words of ``slammot-graph edit``.
    """

    nodes: FloatArray
    node_scans: IntArray
    edges: tuple[GraphEdge, ...]
    keyframe_nodes: IntArray
    keyframe_poses: FloatArray
    keyframe_lasers: IntArray
    keyframe_origins: FloatArray
    keyframe_sizes: IntArray
    points: FloatArray
    normals: FloatArray
    submaps: tuple[IntArray, ...]
    submap_paths: FloatArray
    submap_components: IntArray
    joined: tuple[int, ...]
    runs: tuple[SavedRun, ...]
    odometry_errors: FloatArray
    edits: tuple[str, ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the map of a run folder, or a file of it.

        Parameters
        ----------
        path : str or Path
            ``map.slam``, or the folder that it is in.

        Raises
        ------
        InputError
            There is none, it is damaged, or a newer version of this program wrote it.
        """
        path = Path(path)
        path = path / MAP_FILE if path.is_dir() else path
        check_regular(path, _MOST_BYTES)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror or error}); name the folder of a run that wrote a {MAP_FILE}"
            ) from None
        return cls.from_bytes(data, str(path))

    @classmethod
    def from_bytes(cls, data: bytes, name: str = MAP_FILE) -> Self:
        """Read what `to_bytes` gave; `name` is for the text of the `InputError`."""
        line, _, body = data.partition(b"\n")
        words = line.removeprefix(_MAGIC).split()
        if not line.startswith(_MAGIC) or len(words) != 2 or not words[0].isdigit() or len(words[0]) > 9:
            raise InputError(
                f"{name}: no map of this program; name the folder of a run that wrote a {MAP_FILE}"
            )
        if int(words[0]) > VERSION:
            raise InputError(
                f"{name}: of version {int(words[0])}, newer than the {VERSION} that this program reads; update it"
            )
        if hashlib.sha256(body).hexdigest().encode("ascii") != words[1]:
            raise InputError(
                f"{name}: damaged, its checksum is another one; copy it again, or run its log again"
            )
        try:
            with np.load(io.BytesIO(body), allow_pickle=False) as file:
                arrays = {key: file[key] for key in file.files}
            saved = cls(**_unpacked(arrays))
            saved._check()
        except Exception as error:  # the decoders of a damaged file may raise anything
            raise InputError(f"{name}: damaged ({error}); copy it again, or run its log again") from None
        return saved

    def to_bytes(self) -> bytes:
        """Give the bytes of the file."""
        file = io.BytesIO()
        np.savez_compressed(file, **_packed(self))
        body = file.getvalue()
        checksum = hashlib.sha256(body).hexdigest().encode("ascii")
        return b"%s %d %s\n" % (_MAGIC, VERSION, checksum) + body

    def _check(self) -> None:
        """Refuse, by a `ValueError`, what the checksum does not tell: a writer that made a mistake."""
        m, k, s = len(self.nodes), len(self.keyframe_nodes), len(self.submaps)
        shapes = {
            "nodes": (m, 3),
            "node_scans": (m,),
            "keyframe_nodes": (k,),
            "keyframe_poses": (k, 3),
            "keyframe_lasers": (k,),
            "keyframe_origins": (k, 2),
            "keyframe_sizes": (k,),
            "points": (int(self.keyframe_sizes.sum()), 2),
            "normals": (int(self.keyframe_sizes.sum()), 2),
            "submap_paths": (s,),
            "submap_components": (s,),
            "odometry_errors": (m, 3, 4),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape or not (np.abs(array) < MOST_SENSIBLE).all():
                raise ValueError(f"{name} of shape {array.shape}")
        ends = np.array([(edge.from_node, edge.to_node) for edge in self.edges]).reshape(-1, 2)
        anchors = np.array([self.keyframe_nodes[keyframes[0]] for keyframes in self.submaps], dtype=np.int64)
        numbers = np.concatenate([np.empty(0, dtype=np.int64), *self.submaps])
        for name, index, low, high in (
            ("edges", ends, 0, m),
            ("keyframe_nodes", self.keyframe_nodes, -1, m),
            ("anchors", anchors, 0, m),
            ("submaps", numbers, 0, k),
        ):
            if ((index < low) | (index >= high)).any():
                raise ValueError(f"a number of {name} out of range")
        for edge in self.edges:
            if not (np.isfinite(edge.T_from_to).all() and np.isfinite(edge.information).all()):
                raise ValueError("an edge that is not finite")


@dataclass(frozen=True, kw_only=True, eq=False)
class MapStart:
    """A map that a run starts from, and what it does there.

    Attributes
    ----------
    saved : SavedMap
    localize : bool
        Find the robot in it and follow it there, the map stays as it is; else the run goes on with the map.
    initial_pose : (3,) array or None
        About where the run begins, map frame; None: anywhere.
    """

    saved: SavedMap
    localize: bool = False
    initial_pose: FloatArray | None = None


def _packed(saved: SavedMap) -> dict[str, Any]:
    header = {"runs": [asdict(run) for run in saved.runs], "joined": saved.joined, "edits": saved.edits}
    starts = np.cumsum(saved.keyframe_sizes) - saved.keyframe_sizes
    is_any = saved.keyframe_sizes > 0
    units = np.full(len(starts), 1e-3)
    if len(saved.points):
        largest = np.maximum.reduceat(np.abs(saved.points).max(axis=1), starts[is_any])
        units[is_any] = np.maximum(largest / 32767.0, 1e-4)
    units = units.astype(np.float32)
    of_points = np.repeat(units.astype(np.float64), saved.keyframe_sizes)
    directions = np.round(1e4 * np.arctan2(saved.normals[:, 1], saved.normals[:, 0])).astype(np.int16)
    directions[~saved.normals.any(axis=1)] = _NO_NORMAL
    informations = np.array([edge.information[_UPPER] for edge in saved.edges]).reshape(-1, 6)
    return {
        "header": np.frombuffer(json.dumps(header, allow_nan=False).encode("utf-8"), dtype=np.uint8),
        "nodes": saved.nodes,
        "node_scans": saved.node_scans.astype(np.int32),
        "edge_kinds": np.array([EDGE_KINDS.index(edge.kind) for edge in saved.edges], dtype=np.uint8),
        "edge_nodes": np.array([(edge.from_node, edge.to_node) for edge in saved.edges], np.int32).reshape(
            -1, 2
        ),
        "edge_poses": np.array([edge.T_from_to for edge in saved.edges]).reshape(-1, 3),
        "edge_informations": informations,
        "keyframe_nodes": saved.keyframe_nodes.astype(np.int32),
        "keyframe_poses": saved.keyframe_poses,
        "keyframe_lasers": saved.keyframe_lasers.astype(np.int16),
        "keyframe_origins": saved.keyframe_origins.astype(np.float32),
        "keyframe_sizes": saved.keyframe_sizes.astype(np.int32),
        "keyframe_units": units,
        "points": np.clip(np.round(saved.points / of_points[:, None]), -32767, 32767).astype(np.int16),
        "normals": directions,
        "submap_sizes": np.array([len(keyframes) for keyframes in saved.submaps], dtype=np.int32),
        "submap_keyframes": np.concatenate([np.empty(0, dtype=np.int64), *saved.submaps]).astype(np.int32),
        "submap_paths": saved.submap_paths,
        "submap_components": saved.submap_components.astype(np.int32),
        "odometry_errors": saved.odometry_errors.astype(np.float32).reshape(-1, 12),
    }


def _unpacked(arrays: Mapping[str, Any]) -> dict[str, Any]:
    header = json.loads(arrays["header"].tobytes().decode("utf-8"))
    informations = np.empty((len(arrays["edge_kinds"]), 3, 3))
    informations[:, _UPPER[0], _UPPER[1]] = arrays["edge_informations"]
    informations[:, _UPPER[1], _UPPER[0]] = arrays["edge_informations"]
    edges = tuple(
        GraphEdge(kind=EDGE_KINDS[kind], from_node=a, to_node=b, T_from_to=T, information=information)
        for kind, (a, b), T, information in zip(
            arrays["edge_kinds"].tolist(),
            arrays["edge_nodes"].tolist(),
            arrays["edge_poses"],
            informations,
            strict=True,
        )
    )
    sizes = arrays["keyframe_sizes"].astype(np.int64)
    directions = 1e-4 * arrays["normals"]
    normals = np.column_stack([np.cos(directions), np.sin(directions)])
    normals[arrays["normals"] == _NO_NORMAL] = 0.0
    ends = np.cumsum(arrays["submap_sizes"], dtype=np.int64)
    keyframes = arrays["submap_keyframes"].astype(np.int64)
    if len(keyframes) != (ends[-1] if len(ends) else 0) or (arrays["submap_sizes"] < 1).any():
        raise ValueError("submap_keyframes of another size")
    units = np.repeat(arrays["keyframe_units"].astype(np.float64), sizes)
    return {
        "nodes": arrays["nodes"].astype(np.float64),
        "node_scans": arrays["node_scans"].astype(np.int64),
        "edges": edges,
        "keyframe_nodes": arrays["keyframe_nodes"].astype(np.int64),
        "keyframe_poses": arrays["keyframe_poses"].astype(np.float64),
        "keyframe_lasers": arrays["keyframe_lasers"].astype(np.int64),
        "keyframe_origins": arrays["keyframe_origins"].astype(np.float64),
        "keyframe_sizes": sizes,
        "points": units[:, None] * arrays["points"],
        "normals": normals,
        "submaps": tuple(np.split(keyframes, ends[:-1])) if len(ends) else (),
        "submap_paths": arrays["submap_paths"].astype(np.float64),
        "submap_components": arrays["submap_components"].astype(np.int64),
        "joined": tuple(int(component) for component in header["joined"]),
        "runs": tuple(
            SavedRun(
                log=str(run["log"]),
                first_node=int(run["first_node"]),
                component=int(run["component"]),
                first_scan=int(run.get("first_scan", 0)),
                odometry={str(key): (float(a), float(b)) for key, (a, b) in run["odometry"].items()},
            )
            for run in header["runs"]
        ),
        "odometry_errors": np.asarray(
            arrays.get("odometry_errors", np.zeros((len(arrays["nodes"]), 12))), np.float64
        ).reshape(-1, 3, 4),
        "edits": tuple(str(edit) for edit in header.get("edits", ())),
    }
