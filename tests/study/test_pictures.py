"""Pictures of a study: drawn once, of its scenarios."""

from dataclasses import replace
from pathlib import Path

from matplotlib import image

from slammot_graph.study.pictures import draw_pictures
from slammot_graph.study.plan import plan
from slammot_graph.study.study_file import read_study


def test_a_picture_is_drawn_once_for_its_cells(tiny: Path, tmp_path: Path) -> None:
    rows = plan(read_study(tiny), tmp_path)
    (path,) = draw_pictures(rows, ("icp", "docpfo"), tmp_path)  # docpfo is not in this study
    assert path == tmp_path / "pictures" / "one-walker.png"
    pixels = image.imread(path)[:, :, :3]
    assert pixels.min() < 0.3
    assert pixels.max() > 0.95
    drawn = path.stat().st_mtime_ns
    assert draw_pictures(rows, ("icp",), tmp_path) == [path]
    assert path.stat().st_mtime_ns == drawn
    other = [replace(row, method="icp" if row.method == "odometry" else "odometry") for row in rows]
    draw_pictures(other, ("icp",), tmp_path)
    assert path.stat().st_mtime_ns > drawn
    assert draw_pictures(rows, ("graph",), tmp_path) == []
