import gzip
from pathlib import Path
from typing import Any

import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.logs import open_log
from tests.logs.carmen_text import flaser, write_log


def refusal(path: Path, **topics: Any) -> str:
    with pytest.raises(InputError) as caught:
        open_log(path, **topics)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    return text


def test_no_such_file(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "nothing.clf")
    assert "no such file" in refusal(tmp_path / "nothing.bag")


@pytest.mark.parametrize("name", ["a.clf", "a.clf.gz", "a.clf.bz2", "a.bag", "a.mcap", "a.db3", "a.npz", "a"])
def test_empty_file(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    assert "empty" in refusal(tmp_path / name)


def test_compressed_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.clf.gz").write_bytes(gzip.compress(b""))
    assert "empty" in refusal(tmp_path / "a.clf.gz")


def test_folder_that_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert "no ROS 2 bag" in refusal(tmp_path)


@pytest.mark.parametrize("name", ["a.xyz", "a", "a.clf"])
def test_unknown_content(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\x01\x00\x02\x03" * 100)
    assert "known are CARMEN" in refusal(tmp_path / name)


def test_text_that_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    assert "no laser lines" in refusal(tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
def test_text_named_as_a_bag(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("hello")
    assert "whatever its name says" in refusal(tmp_path / name)


def test_bag_named_otherwise(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_bytes(b"#ROSBAG V2.0\nabc")
    assert "ending .bag" in refusal(tmp_path / "a.dat")


def test_topics_are_for_bags(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.clf", [flaser([1.0] * 180, 1.0)])
    assert "--scan-topic" in refusal(path, scan_topic="/scan")
    assert "--odom-topic" in refusal(path, odom_topic="/odom")


def test_path_may_be_text(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.clf", [flaser([1.0] * 180, 1.0)])
    assert open_log(str(path)).n_scans == 1
