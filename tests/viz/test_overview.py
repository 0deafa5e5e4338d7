"""The overview picture: it says what it shows, keeps to its page, and is there for every shape of run."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Annotation, Text

from slammot_graph import Run
from slammot_graph.core.results import GraphEdge, GridMap, RunResult
from slammot_graph.viz.colors import COLOR_MOVED, to_hex, track_color
from slammot_graph.viz.overview import compose_overview, draw_overview
from tests.rooms import drive
from tests.viz.colours import as_numbers


@cache
def result() -> RunResult:
    return Run(drive(40)).complete()


def picture(run: RunResult, path: Path) -> np.ndarray:
    draw_overview(run, path)
    return imread(path)


def n_colors(image: np.ndarray) -> int:
    return len(np.unique(as_numbers(image[..., :3] * 255)))


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def lines_of(figure: Figure, label: str) -> list[np.ndarray]:
    """The points of the lines that are called so."""
    lines = figure.axes[0].get_lines()
    return [np.asarray(line.get_xydata()) for line in lines if line.get_label() == label]


def walk(track_id: int, n: int = 3, *, speed_m_s: float = 1.0) -> np.ndarray:
    """Tracks of one object of constant speed, row by row one metre to the right of the origin."""
    tracks = np.zeros((n, 10))
    tracks[:, 0], tracks[:, 1], tracks[:, 4] = np.arange(n), track_id, speed_m_s
    tracks[:, 2] = np.arange(n)
    return tracks


def with_tracks(n: int, run: RunResult | None = None) -> RunResult:
    tracks = np.vstack([np.empty((0, 10)), *(walk(k) for k in range(n))])
    return replace(run or result(), tracks=tracks, is_track_seen=np.ones(len(tracks), dtype=bool))


def with_closures(n: int) -> RunResult:
    run = result()
    edge = GraphEdge(
        kind="closure",
        from_node=0,
        to_node=len(run.nodes) - 1,
        T_from_to=np.zeros(3),
        information=np.eye(3),
    )
    return replace(run, edges=(edge,) * n)


def no_map() -> GridMap:
    return GridMap(p_occupied=np.full((1, 1), np.nan), resolution_m=0.05, origin=np.zeros(2))


def empty() -> RunResult:
    """A run that was cut short before its first scan."""
    run = result()
    return replace(
        run,
        stamps=run.stamps[:0],
        T_map_base=run.T_map_base[:0],
        T_map_odom_base=run.T_map_odom_base[:0],
        tracks=run.tracks[:0],
        is_track_seen=run.is_track_seen[:0],
        nodes=run.nodes[:0],
        edges=(),
        grid=no_map(),
        is_complete=False,
    )


def room(shape: tuple[int, int]) -> GridMap:
    p = np.full(shape, 0.05)
    p[0] = 0.95
    return GridMap(p_occupied=p, resolution_m=0.05, origin=np.array([-1.0, -1.0]))


def test_a_run_gives_a_picture_of_map_and_trajectory(tmp_path: Path) -> None:
    image = picture(result(), tmp_path / "overview.png")
    assert min(image.shape[:2]) > 300
    assert n_colors(image) > 20
    dark = (image[..., :3] < 0.2).all(axis=2)
    assert dark.sum() > 100  # walls and text


def test_the_legend_names_all_that_is_drawn() -> None:
    points = np.array([[1.0, 1.0], [2.0, 1.0]])
    run = with_tracks(2, with_closures(1))
    assert labels(compose_overview(run, moving_points=points)) == [
        *("trajectory", "start", "end", "raw odometry", "loop closures"),
        *("moving points", "2 tracks of moving objects (a colour each; dot and number where last seen)"),
        *("free", "unknown", "occupied", "map's origin, x and y"),
    ]


def test_the_legend_names_nothing_that_is_not_drawn() -> None:
    run = replace(with_tracks(0), edges=())
    said = labels(compose_overview(run, moving_points=np.array([[1e3, 0.0], [np.nan, 0.0]])))
    assert said == [
        *("trajectory", "start", "end", "raw odometry"),
        *("free", "unknown", "occupied", "map's origin, x and y"),
    ]
    said = labels(compose_overview(empty()))
    assert said == ["free", "unknown", "occupied", "map's origin, x and y"]
    away = replace(run, T_map_base=run.T_map_base + np.array([50.0, 0.0, 0.0]), grid=no_map())
    assert "map's origin, x and y" not in labels(compose_overview(away))


def test_the_title_names_method_log_and_counts() -> None:
    run = replace(with_tracks(1, with_closures(1)), is_complete=False)
    title, counts = (text.get_text() for text in compose_overview(run, log_name="a $1$ log.bag").texts)
    assert title == "graph on a $1$ log.bag"
    n_nodes = len(run.nodes)
    path_m = np.hypot(*np.diff(run.T_map_base[:, :2], axis=0).T).sum()
    assert (
        counts == f"interrupted after 40 scans · {path_m:.0f} m · {n_nodes} nodes · 1 loop closure · 1 track"
    )
    assert compose_overview(result()).texts[0].get_text() == "graph"


@pytest.mark.parametrize("name", ["x" * 400 + ".bag", "日本\n\udcff.bag"])
@pytest.mark.parametrize("shape", [(130, 160), (3, 400), (5000, 40)])
def test_nothing_leaves_the_page(name: str, shape: tuple[int, int]) -> None:
    run = replace(with_tracks(9, with_closures(1)), grid=room(shape))
    run = replace(run, T_map_odom_base=100.0 * run.T_map_odom_base)
    figure = compose_overview(run, log_name=name, moving_points=np.zeros((1, 2)))
    figure.canvas.draw()
    page = figure.bbox
    assert max(figure.get_size_inches()) < 10.0
    drawn = [*figure.legends, *figure.texts, *figure.axes[0].findobj(Text), figure.axes[0].patch]
    for artist in drawn:
        if artist in figure.axes[0].texts and artist.get_clip_on():
            continue  # numbers of tracks and names of axes end where the map does
        box = artist.get_window_extent()
        assert page.x0 <= box.x0 <= box.x1 <= page.x1, artist
        assert page.y0 <= box.y0 <= box.y1 <= page.y1, artist
    rows = [legend.get_window_extent() for legend in figure.legends]
    scale_bar = next(text for text in figure.axes[0].texts if text.get_text().endswith(" m"))
    tops = [box.y1 for box in (*rows, scale_bar.get_window_extent())]
    bottoms = [box.y0 for box in (*rows, scale_bar.get_window_extent())]
    order = np.argsort(tops)
    assert all(np.array(bottoms)[order][1:] > np.array(tops)[order][:-1])


def closures_of(figure: Figure) -> LineCollection:
    (found,) = (lines for lines in figure.axes[0].collections if lines.get_label() == "loop closures")
    assert isinstance(found, LineCollection)
    return found


def test_closures_lie_below_the_trajectory_and_many_are_a_haze() -> None:
    few, many = (compose_overview(with_closures(n)) for n in (1, 51))
    assert len(closures_of(few).get_segments()) == 1
    assert len(closures_of(many).get_segments()) == 51
    widths = [np.atleast_1d(closures_of(figure).get_linewidth())[0] for figure in (few, many)]
    assert widths[1] < 0.6 * widths[0]
    alphas = [float(closures_of(figure).get_alpha() or np.nan) for figure in (few, many)]
    assert alphas[1] < alphas[0]
    for figure in (few, many):
        (path,) = (line for line in figure.axes[0].get_lines() if line.get_label() == "trajectory")
        assert closures_of(figure).get_zorder() < path.get_zorder()


def test_odometry_that_leaves_the_picture_is_clipped_and_said_to_be() -> None:
    run = result()
    near, far = (
        compose_overview(replace(run, T_map_odom_base=run.T_map_odom_base + np.array([x, 0.0, 0.0])))
        for x in (0.0, 100.0)
    )
    assert "raw odometry" in labels(near)
    assert "raw odometry (leaves the picture)" in labels(far)
    assert near.axes[0].get_xlim() == far.axes[0].get_xlim()


def test_the_picture_ends_where_the_map_is_known() -> None:
    grid = room((60, 60))
    p = np.full((500, 500), 0.5)
    p[:60, :60] = grid.p_occupied
    around, known = (
        compose_overview(replace(result(), grid=replace(grid, p_occupied=cells)))
        for cells in (p, grid.p_occupied)
    )
    assert around.axes[0].get_ylim() == known.axes[0].get_ylim()


def test_moving_points_are_thinned() -> None:
    rng = np.random.default_rng(0)
    points = np.vstack([rng.uniform(0.0, 0.3, (5000, 2)), [[2.0, 1.0], [np.inf, 1.0], [1e4, 0.0]]])
    figure = compose_overview(result(), moving_points=points)
    (drawn,) = lines_of(figure, "moving points")
    assert 10 < len(drawn) < 500
    assert [2.0, 1.0] in drawn.tolist()
    assert {tuple(point) for point in drawn} <= {tuple(point) for point in points}
    (line,) = (line for line in figure.axes[0].get_lines() if line.get_label() == "moving points")
    assert same_color(line.get_color(), to_hex(COLOR_MOVED))


def test_what_has_changed_since_a_saved_map_is_drawn() -> None:
    new, gone = np.array([[0.5, 0.2], [0.55, 0.2]]), np.array([[1.0, -0.3]])
    figure = compose_overview(replace(result(), new_points=new, gone_points=gone))
    (drawn,) = lines_of(figure, "changed: new")
    np.testing.assert_array_equal(drawn, new)
    (drawn,) = lines_of(figure, "changed: gone")
    np.testing.assert_array_equal(drawn, gone)
    assert {"changed: new", "changed: gone"} <= set(labels(figure))
    assert not any("changed" in label for label in labels(compose_overview(result())))


def test_a_track_ends_where_its_object_was_last_seen() -> None:
    tracks = np.vstack([walk(3, 6), walk(4, 2), walk(5, 1)])
    is_seen = np.array([True, True, False, True, False, False, True, False, False])
    figure = compose_overview(replace(result(), tracks=tracks, is_track_seen=is_seen))
    (seen,) = lines_of(figure, "track 3")
    np.testing.assert_array_equal(seen[:, 0], [0.0, 1.0, 3.0])
    (once,) = lines_of(figure, "track 4")
    assert len(once) == 1
    assert lines_of(figure, "track 5") == []
    numbers = [text for text in figure.axes[0].texts if text.get_text() == "3"]
    assert [text.xy for text in numbers if isinstance(text, Annotation)] == [(3.0, 0.0)]
    assert same_color(numbers[0].get_color(), to_hex(track_color(3)))


def test_who_is_seen_to_stand_or_to_walk_evenly_is_drawn_wherever_he_was_seen() -> None:
    """An object may keep its speed exactly: that does not tell whether the laser saw it."""
    for speed_m_s in (0.0, 1.0):
        tracks = walk(1, 5, speed_m_s=speed_m_s)
        run = replace(result(), tracks=tracks, is_track_seen=np.ones(5, dtype=bool))
        (seen,) = lines_of(compose_overview(run), "track 1")
        np.testing.assert_array_equal(seen[:, 0], np.arange(5.0))


@pytest.mark.parametrize(
    ("n", "label"),
    [
        (1, "1 track of a moving object (dot and number where last seen)"),
        (9, "9 tracks of moving objects (a colour each; dot and number where last seen)"),
        (10, "10 tracks of moving objects (dot and number where last seen)"),
        (13, "13 tracks of moving objects (dot where last seen)"),
    ],
)
def test_many_tracks_have_neither_numbers_nor_colours_of_their_own(n: int, label: str) -> None:
    figure = compose_overview(with_tracks(n))
    assert label in labels(figure)
    n_numbers = sum(text.get_text().isdecimal() for text in figure.axes[0].texts)
    assert n_numbers == (n if n <= 12 else 0)


@pytest.mark.parametrize("shape", [(1, 1), (3, 400), (5000, 40)])
def test_maps_of_any_size_are_drawn(tmp_path: Path, shape: tuple[int, int]) -> None:
    image = picture(replace(result(), grid=room(shape)), tmp_path / "overview.png")
    assert max(image.shape[:2]) < 6000
    assert n_colors(image) > 5


def test_a_run_without_tracks_nodes_or_map_is_drawn(tmp_path: Path) -> None:
    run = replace(with_tracks(0), nodes=np.empty((0, 3)), edges=(), grid=no_map(), is_complete=False)
    assert n_colors(picture(run, tmp_path / "overview.png")) > 5
    assert n_colors(picture(empty(), tmp_path / "overview.png")) > 5
