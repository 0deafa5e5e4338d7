"""Scans made of PointCloud2: fields of any type and order, slices of heights, times of the beams."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.logs import open_log, source_of
from slammot_graph.logs.bag_clouds import (
    TYPES,
    CloudSlice,
    CloudSlicer,
    fitting_bin_count,
    point_times,
)
from tests.logs import bag_files as bf

SLICE = (0.2, 0.6)
CODES = {name: code for code, name in TYPES.items()}


def cloud(
    stamp: float,
    points: FloatArray,
    *,
    kind: str = "f4",
    is_bigendian: bool = False,
    height: int = 1,
    time: tuple[str, npt.NDArray[Any]] | None = None,
) -> bf.Sent:
    """A cloud with an intensity and unused bytes before and between its fields, rows with some behind them."""
    order = ">" if is_bigendian else "<"
    names, formats = ["intensity", "x", "y", "z"], ["<u2", *[order + kind] * 3]
    size = np.dtype(kind).itemsize
    offsets = [1, 4, 4 + size, 4 + 3 * size]
    if time is not None:
        names, formats, offsets = (
            [*names, time[0]],
            [*formats, order + time[1].dtype.str[1:]],
            [*offsets, 8 + 4 * size],
        )
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 20 + 4 * size})
    rows = np.zeros(len(points), dtype=dtype)
    for k, name in enumerate("xyz"):
        rows[name] = points[:, k]
    if time is not None:
        rows[time[0]] = time[1]
    width = len(points) // height
    raw = np.frombuffer(rows.tobytes(), dtype=np.uint8).reshape(height, -1)
    raw = np.hstack([raw, np.full((height, 3), 255, dtype=np.uint8)])
    fields = [
        bf.Part(
            "sensor_msgs/msg/PointField",
            {"name": name, "offset": offset, "datatype": CODES[np.dtype(form).str[1:]], "count": 1},
        )
        for name, form, offset in zip(names, formats, offsets, strict=True)
    ]
    content = {
        "header": bf.header(stamp, "lidar"),
        "height": height,
        "width": width,
        "fields": fields,
        "is_bigendian": is_bigendian,
        "point_step": dtype.itemsize,
        "row_step": raw.shape[1],
        "data": raw.ravel(),
        "is_dense": False,
    }
    return bf.Sent("/points", stamp + 0.05, "sensor_msgs/msg/PointCloud2", content)


def wall(n: int = 1440) -> FloatArray:
    """Points (2 n + 1, 3), lidar frame: a round wall at 4 m in the slice, one at 2 m below it, and no point."""
    angles = 2.0 * math.pi * (np.arange(n) + 0.5) / n - math.pi
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    below = 0.5 * ring + (0.0, 0.0, -0.2)
    return np.vstack([4.0 * ring, 4.0 * below, np.full((1, 3), np.nan)])


@pytest.mark.parametrize("kind", bf.FORMATS)
@pytest.mark.parametrize(
    ("number", "is_bigendian", "height"), [("f4", False, 1), ("f8", True, 1), ("f4", True, 131)]
)
def test_scans_of_clouds(tmp_path: Path, kind: str, number: str, is_bigendian: bool, height: int) -> None:
    points = wall(720)[: 131 * 11]
    sent = [
        cloud(10.0 + 0.1 * k, points, kind=number, is_bigendian=is_bigendian, height=height) for k in range(3)
    ]
    tf = bf.transform(10.0, "base_link", "lidar", (0.1, 0.2, 1.0))
    path = bf.write_bag(tmp_path, [*sent, tf], kind)
    log = open_log(path, cloud_topic="/points", heights=(0.1, 0.3))
    scans = list(log)
    assert len(scans) == 3
    laser = scans[0].laser
    assert laser.T_base_laser == (0.1, 0.2, 0.0)
    assert laser.n_beams == 720
    np.testing.assert_allclose(scans[0].ranges, 4.0, atol=1e-5)
    assert source_of(log)["cloud_topic"] == "/points"
    assert tuple(source_of(log)["slice"]) == (0.1, 0.3)


def test_the_nearest_point_of_a_bin_and_bins_without_one() -> None:
    slicer = CloudSlicer(np.eye(4), CloudSlice(z_min_m=0.2, z_max_m=0.6), n_beams=360)
    points = np.array([[3.0, 0.01, 0.3], [2.0, 0.01, 0.5], [1.0, 0.01, 0.1], [0.0, 5.0, 0.6]])
    sweep = slicer.sweep(points, np.array([0.0, 0.01, 0.02, 0.03]))
    assert np.flatnonzero(np.isfinite(sweep.ranges)).tolist() == [180, 270]
    assert sweep.ranges[[180, 270]] == pytest.approx([math.hypot(2.0, 0.01), 5.0])
    assert sweep.times_s is not None
    assert sweep.times_s[[180, 270, 200, 260]] == pytest.approx([0.01, 0.03, 0.01, 0.03])
    found = slicer.laser.directions_base[180] * sweep.ranges[180]
    assert found == pytest.approx([2.0, 0.0], abs=0.02)


def test_a_lidar_upside_down_and_tilted() -> None:
    T = np.eye(4)
    c, s = math.cos(0.3), math.sin(0.3)
    T[:3, :3] = np.array([[c, 0.0, -s], [0.0, -1.0, 0.0], [-s, 0.0, -c]])
    T[:3, 3] = 0.1, 0.0, 0.8
    place = np.array([2.0, 1.0, 0.4])  # base frame
    point = np.linalg.inv(T) @ np.append(place, 1.0)
    slicer = CloudSlicer(T, CloudSlice(z_min_m=0.3, z_max_m=0.5), n_beams=720)
    ranges = slicer.sweep(point[None, :3], None).ranges
    (beam,) = np.flatnonzero(np.isfinite(ranges))
    found = slicer.laser.origin_base + ranges[beam] * slicer.laser.directions_base[beam]
    assert found == pytest.approx(place[:2], abs=0.01)


@pytest.mark.parametrize(
    "raw",
    [
        np.array([0, 50_000_000, 100_000_000], dtype=np.uint32),  # nanoseconds, as Ouster
        np.array([0.0, 0.05, 0.1], dtype=np.float32),  # seconds, as Velodyne
        np.array([0.0, 50.0, 100.0], dtype=np.float64),  # milliseconds
        np.array([0.0, 5e4, 1e5], dtype=np.float32),  # microseconds
        np.array([1e9, 1e9 + 0.05, 1e9 + 0.1]),  # absolute, as Hesai
        np.array([10**18, 10**18 + 50_000_000, 10**18 + 100_000_000], dtype=np.uint64),
    ],
)
def test_times_of_points_in_any_unit(raw: npt.NDArray[Any]) -> None:
    times = point_times(raw, 1e9)
    assert times is not None
    assert times == pytest.approx([0.0, 0.05, 0.1], abs=1e-6)


def test_times_that_are_none() -> None:
    assert point_times(np.zeros(5), 1e9) is None
    assert point_times(np.empty(0), 1e9) is None
    ends = point_times(np.array([-0.1, -0.05, 0.0]), 1e9)  # a driver that stamps the end
    assert ends is not None
    assert ends == pytest.approx([-0.1, -0.05, 0.0])


def test_bins_as_fine_as_the_points_fill() -> None:
    assert [
        fitting_bin_count(2.0 * math.pi * (np.arange(n) + 0.5) / n - math.pi) for n in (1800, 900, 400)
    ] == [
        1440,
        720,
        360,
    ]
    half = math.pi * (np.arange(1000) + 0.5) / 1000
    assert fitting_bin_count(half) == 1440


def test_what_a_user_can_get_wrong(tmp_path: Path) -> None:
    path = bf.write_bag(tmp_path, [cloud(10.0, wall(360)), cloud(10.1, wall(360))])
    with pytest.raises(InputError, match=r"no LaserScan.*make scans of /points with --cloud-topic T --slice"):
        open_log(path)
    with pytest.raises(ConfigError, match="both --cloud-topic"):
        open_log(path, cloud_topic="/points")
    with pytest.raises(ConfigError, match="Z_MIN < Z_MAX"):
        open_log(path, cloud_topic="/points", heights=(1.0, 0.0))
    with pytest.raises(
        InputError, match=r"no point of /points lies between 2 and 3 m .* between -0.80 and 0.00 m"
    ):
        open_log(path, cloud_topic="/points", heights=(2.0, 3.0))
    with pytest.raises(InputError, match=r"no topic /cloud; --cloud-topic can be /points"):
        open_log(path, cloud_topic="/cloud", heights=SLICE)


def test_beams_of_a_cloud_have_the_times_of_their_points(tmp_path: Path) -> None:
    points = wall(720)
    turn = np.mod(np.arctan2(points[:, 1], points[:, 0]) - 0.5, 2.0 * math.pi) / (2.0 * math.pi)
    times = (0.1 * np.nan_to_num(turn)).astype(np.float32)  # the lidar's turn begins at 0.5 rad
    sent = [cloud(10.0 + 0.1 * k, points, time=("t", times)) for k in range(3)]
    tf = bf.transform(10.0, "base_link", "lidar", (0.0, 0.0, 0.0))
    path = bf.write_bag(tmp_path, [*sent, tf])
    scan = next(iter(open_log(path, cloud_topic="/points", heights=(0.1, 0.3))))
    assert scan.beam_times is not None
    expected = 0.1 * np.mod(scan.laser.angles_base - 0.5, 2.0 * math.pi) / (2.0 * math.pi)
    np.testing.assert_allclose(scan.beam_times, expected, atol=1e-3)
    (tmp_path / "untimed").mkdir()
    untimed = bf.write_bag(tmp_path / "untimed", [cloud(10.0, points), cloud(10.1, points), tf])
    scan = next(iter(open_log(untimed, cloud_topic="/points", heights=(0.1, 0.3))))
    assert scan.beam_times is None
