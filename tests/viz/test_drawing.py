"""The page around a map: limits, lines of the legend, titles, and colours that can be told apart."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from slammot_graph.core.results import GridMap
from slammot_graph.viz.colors import (
    COLOR_CLOSURE,
    COLOR_ESTIMATE,
    COLOR_MOVED,
    COLOR_MOVING,
    COLOR_ODOMETRY,
    TRACK_COLORS,
    track_color,
)
from slammot_graph.viz.drawing import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Limits,
    draw_title,
    find_limits,
    lay_out,
    line_entry,
    states_of,
    text_width_in,
)


def grid(p_occupied: object, origin: tuple[float, float] = (0.0, 0.0)) -> GridMap:
    return GridMap(p_occupied=np.array(p_occupied, dtype=float), resolution_m=1.0, origin=np.array(origin))


NOTHING = grid(np.zeros((0, 0)))


def test_a_cell_is_free_or_occupied_only_where_the_map_is_sure() -> None:
    assert states_of(grid([[0.1, 0.2, 0.5, 0.8, 0.9, np.nan]])).tolist() == [
        [FREE, UNKNOWN, UNKNOWN, UNKNOWN, OCCUPIED, UNKNOWN]
    ]


def test_limits_hold_the_known_map_and_the_trajectory() -> None:
    p = np.full((20, 30), 0.5)
    p[2, 4], p[12, 9] = 0.9, 0.1
    limits = find_limits(np.array([[-3.0, 8.0, 0.0], [np.nan, 90.0, 0.0]]), grid(p, (1.0, 2.0)))
    assert limits.x_m == pytest.approx((-3.5, 11.5))
    assert limits.y_m == pytest.approx((3.5, 15.5))
    assert limits.contain(np.array([[0.0, 4.0], [0.0, 3.0], [12.0, 4.0], [np.nan, 4.0]])).tolist() == [
        *(True, False, False, False)
    ]


def test_a_few_cells_far_off_do_not_shrink_the_picture() -> None:
    p = np.full((300, 400), np.nan)
    p[100:200, 100:200] = 0.1
    alone = find_limits(np.zeros((0, 3)), grid(p))
    assert alone.x_m + alone.y_m == pytest.approx((99.5, 200.5, 99.5, 200.5))
    p[10, 390] = 0.9
    assert find_limits(np.zeros((0, 3)), grid(p)) == alone
    p[5, 380:390] = 0.9
    assert find_limits(np.zeros((0, 3)), grid(p)).x_m[1] > 380.0


def test_limits_of_nothing_are_around_the_origin() -> None:
    limits = find_limits(np.zeros((0, 3)), NOTHING)
    assert limits.size_m == pytest.approx((4.0, 4.0))
    assert limits.contain(np.zeros((1, 2))).all()


@pytest.mark.parametrize(("width_m", "height_m"), [(9.0, 7.0), (4.0, 400.0), (400.0, 4.0), (30.0, 30.0)])
def test_the_map_fills_the_page_in_its_true_shape(width_m: float, height_m: float) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [width_m, height_m, 0.0]])
    page = lay_out(find_limits(corners, NOTHING), [])
    width_in, height_in = page.map_in
    assert width_in == pytest.approx(6.0) or height_in == pytest.approx(7.2)
    assert width_in <= 6.0 + 1e-9
    assert height_in <= 7.2 + 1e-9
    assert height_in / width_in == pytest.approx(page.limits.size_m[1] / page.limits.size_m[0])
    assert 5.0 <= page.width_in < 6.5
    left, bottom, width, height = page.map_box()
    assert (left + 0.5 * width, width * page.width_in) == pytest.approx((0.5, width_in))
    assert 0.0 < bottom < bottom + height < 1.0
    assert height * page.height_in == pytest.approx(height_in)


def test_groups_of_the_legend_begin_a_line_and_long_ones_go_on_in_the_next() -> None:
    limits = Limits(x_m=(0.0, 10.0), y_m=(0.0, 10.0))
    long = [line_entry(f"{k} {20 * 'n'}", color="black") for k in range(5)]
    page = lay_out(limits, [[line_entry("a"), line_entry("b")], [], long])
    lines = [[entry.label[0] for entry in line] for line in page.legend]
    assert lines[0] == ["a", "b"]
    assert len(lines) > 2
    assert [label for line in lines[1:] for label in line] == ["0", "1", "2", "3", "4"]
    assert page.height_in > lay_out(limits, [long[:1]]).height_in
    too_long = lay_out(limits, [[line_entry(200 * "n")]])
    assert [len(line) for line in too_long.legend] == [1]


def test_a_title_is_shortened_to_the_page_and_holds_any_name() -> None:
    page = lay_out(Limits(x_m=(0.0, 10.0), y_m=(0.0, 10.0)), [])
    figure = Figure()

    def title(text: str) -> str:
        return draw_title(figure, page, text, above_in=0.1, size_pt=10.0, weight="bold").get_text()

    assert title("graph on $x$.bag") == "graph on $x$.bag"
    assert title("a\nb\t日\udcff\x07") == "a b ???"
    assert title("") == ""
    short = title(300 * "x")
    assert short.endswith("xx…")
    assert page.inner_in - 0.2 < text_width_in(short, 10.0, weight="bold") <= page.inner_in


def test_tracks_have_colours_apart_from_each_other_and_from_what_they_cross() -> None:
    others = (
        COLOR_ESTIMATE,
        COLOR_ODOMETRY,
        COLOR_CLOSURE,
        COLOR_MOVED,
        COLOR_MOVING,
        0xFFFFFFFF,
        0x19191EFF,
    )
    colors = np.array([(*TRACK_COLORS, *others)], dtype=np.int64)[0]
    rgb = np.column_stack([colors >> shift & 255 for shift in (24, 16, 8)]) / 255.0
    # a simple distance that weighs red less where colours are dark (https://www.compuphase.com/cmetric.htm)
    red = 0.5 * (rgb[:, None, 0] + rgb[None, :, 0])
    square = (rgb[:, None] - rgb[None]) ** 2
    apart = np.sqrt((2.0 + red) * square[..., 0] + 4.0 * square[..., 1] + (3.0 - red) * square[..., 2])
    np.fill_diagonal(apart, np.inf)
    assert apart[: len(TRACK_COLORS)].min() > 0.3
    assert len({track_color(track_id) for track_id in range(9)}) == 9
    assert track_color(0) == track_color(len(TRACK_COLORS))
