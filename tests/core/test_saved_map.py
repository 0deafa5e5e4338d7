"""``map.slam`` is a contract: what is written is read back, and what is no such file is told in one line."""

import hashlib
import io
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import InputError, Run, SavedMap
from slammot_graph.core.results import RunResult
from slammot_graph.loop_closure.saved_submaps import load_submaps
from slammot_graph.loop_closure.submap import SubmapConfig
from tests.loop_closure.ring import ring_log


@cache
def result() -> RunResult:
    return Run(ring_log(1)).complete()


@cache
def saved() -> SavedMap:
    found = result().saved_map
    assert found is not None
    return found


def archive_of(data: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(data.partition(b"\n")[2]), allow_pickle=False) as file:
        return {key: file[key] for key in file.files}


def with_arrays(**arrays: np.ndarray) -> bytes:
    """The file with other arrays, and a checksum that is right."""
    return file_of({**archive_of(saved().to_bytes()), **arrays})


def file_of(arrays: dict[str, np.ndarray]) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)  # type: ignore[arg-type]
    body = out.getvalue()
    return f"slammot-graph map 1 {hashlib.sha256(body).hexdigest()}\n".encode() + body


def test_a_map_is_read_back(tmp_path: Path) -> None:
    result().save(tmp_path / "run")
    read = SavedMap.load(tmp_path / "run")
    np.testing.assert_array_equal(read.nodes, result().nodes)
    np.testing.assert_array_equal(read.node_scans, result().node_scans)
    np.testing.assert_array_equal(read.keyframe_poses, saved().keyframe_poses)
    np.testing.assert_array_equal(read.keyframe_sizes, saved().keyframe_sizes)
    np.testing.assert_allclose(read.points, saved().points, atol=1e-3)
    np.testing.assert_allclose(read.normals, saved().normals, atol=1e-4)
    for edge, other in zip(read.edges, result().edges, strict=True):
        assert (edge.kind, edge.from_node, edge.to_node) == (other.kind, other.from_node, other.to_node)
        np.testing.assert_array_equal(edge.T_from_to, other.T_from_to)
        np.testing.assert_allclose(edge.information, other.information, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(read.odometry_errors, saved().odometry_errors, rtol=1e-6)
    assert saved().odometry_errors[1:].any(axis=(1, 2)).all()
    assert read.joined == (0,)
    assert read.runs[0].first_node == 0
    assert all(std > 0.0 for _, std in read.runs[0].odometry.values())


def test_its_local_maps_are_those_of_the_run() -> None:
    read = SavedMap.from_bytes(saved().to_bytes())
    submaps = load_submaps(read, SubmapConfig())
    assert len(submaps) == len(saved().submaps) > 3
    for number, submap in enumerate(submaps):
        assert (submap.number, submap.anchor) == (number, read.keyframe_nodes[read.submaps[number][0]])
        points, normals = submap.points_and_normals
        assert len(points) == len(normals) > 100
        np.testing.assert_allclose(np.hypot(*normals.T).max(), 1.0)
    # a keyframe that two local maps share is one
    assert submaps[0].keyframes[-1] is submaps[1].keyframes[-8]


def test_a_file_without_the_odometrys_common_errors_is_read() -> None:
    arrays = archive_of(saved().to_bytes())
    del arrays["odometry_errors"]
    read = SavedMap.from_bytes(file_of(arrays))
    np.testing.assert_array_equal(read.odometry_errors, np.zeros((len(read.nodes), 3, 4)))


def test_a_kept_scan_takes_no_more_than_2_kb() -> None:
    assert len(saved().to_bytes()) <= 2000 * len(saved().keyframe_nodes)


def test_a_newer_version_is_told() -> None:
    data = saved().to_bytes().replace(b"map 1 ", b"map 2 ", 1)
    with pytest.raises(InputError, match="of version 2, newer than the 1 that this program reads; update it"):
        SavedMap.from_bytes(data)


@pytest.mark.parametrize("at", [0.01, 0.5, 0.99])
def test_a_changed_byte_is_found(at: float) -> None:
    data = bytearray(saved().to_bytes())
    data[int(at * len(data))] ^= 1
    with pytest.raises(InputError, match="copy it again"):
        SavedMap.from_bytes(bytes(data))


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"slammot-graph map x y\n", b"PK\x03\x04", b"slammot-graph map 1 \n"]
)
def test_another_file_is_no_map(data: bytes) -> None:
    with pytest.raises(InputError, match="no map of this program"):
        SavedMap.from_bytes(data)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("keyframe_nodes", 10**6),
        ("submap_keyframes", -1),
        ("edge_nodes", 10**6),
        ("edge_kinds", 9),
        ("nodes", np.nan),
        ("edge_informations", np.inf),
        ("keyframe_sizes", 3),
        ("submap_sizes", 0),
        ("header", 0),
    ],
)
def test_arrays_that_do_not_fit_together_are_damage(name: str, value: float) -> None:
    array = archive_of(saved().to_bytes())[name].copy()
    array.flat[0] = value
    with pytest.raises(InputError, match=r"damaged \("):
        SavedMap.from_bytes(with_arrays(**{name: array}))


def test_without_a_map_the_remedy_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'map.slam'}: cannot be read")):
        SavedMap.load(tmp_path)


def test_a_method_without_a_graph_has_no_map() -> None:
    assert Run(ring_log(1), "icp", max_scans=5).complete().saved_map is None
