"""Draw ``how_it_works.svg``: one scan's way through the pipeline, with the files and what they share.

Run it from anywhere: ``python docs/how_it_works.py``. Rows are the stages, columns what is kept from scan to scan.
"""

import sys
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

STAGES = (
    ("1  predict", "last pose and the odometry; the covariance grows by R_r",
     ("odometry/propagation.py", "odometry/noise.py")),
    ("2  detect", "an ellipse on free cells only: moving; clusters",
     ("detection/ellipse_test.py", "detection/clustering.py", "detection/visibility_check.py")),
    ("3  match", "static points onto lines, robust, from the prediction",
     ("localization/map_matching.py", "registration/point_to_line.py")),
    ("4  graph", "a node for each keyframe, smoothed by GTSAM's ISAM2",
     ("localization/graph_insertion.py", "graph/pose_graph.py")),
    ("5  map", "static points occupy, all beams free what they cross",
     ("mapping/occupancy_grid.py",)),
    ("6  objects", "clusters of moving points become tracks",
     ("tracking/tracker.py",)),
    ("7  close loops", "runs within 4, whenever a local map is finished",
     ("loop_closure/detector.py", "loop_closure/verification.py")),
)  # fmt: skip
"""Name, what it does, files within the package."""

PASSED = (
    "scan, odometry",
    "predicted pose and its covariance",
    "is_moving, a label for each beam",
    "matched pose, its covariance, converged or not",
    "matched pose, which points are static",
    "matched pose, clusters of moving points",
    "now and then: a finished local map",
    "StepResult",
)
"""What goes into each stage from the one above; the last comes out."""

KEPT = (
    ("occupancy grid", "mapping/occupancy_grid.py"),
    ("local maps", "mapping/local_map.py"),
    ("pose graph", "graph/pose_graph.py"),
    ("tracks", "tracking/tracker.py"),
)
"""What outlives a scan."""

READ, WRITE = "reads", "writes"
USES = (
    (0, 2, READ, "covariance relative\nto the anchor"),
    (1, 0, READ, "free, occupied\nand unknown cells"),
    (1, 3, READ, "where people\nshould be now"),
    (2, 1, READ, "points and normals"),
    (3, 2, WRITE, "odometry factor (R_r),\nmatch factor"),
    (3, 1, WRITE, "a keyframe"),
    (4, 0, WRITE, "hits and passes"),
    (5, 3, WRITE, "position, velocity"),
    (6, 1, READ, "finished local maps"),
    (6, 2, WRITE, "closure factors"),
)
"""Stage, what is kept, read or written, and what of it."""

COLORS = {READ: ("#e7f0fd", "#1c5fd4"), WRITE: ("#fdeee0", "#b35309")}
INK, PALE, LINE = "#1f2328", "#59636e", "#c4cad1"
ROW, STAGE_WIDTH, STAGE_HEIGHT = 1.12, 4.3, 0.78
FIRST_COLUMN, COLUMN, CHIP_WIDTH = 5.95, 1.78, 1.62


def main() -> None:
    """Draw the figure beside this file, and as PNG too if a path for it is given."""
    width, height = FIRST_COLUMN + 3.5 * COLUMN + 0.1, ROW * len(STAGES) + 1.35
    with rc_context({"svg.hashsalt": "how_it_works", "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(width, height), facecolor="white")
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, width), ylim=(-height + 0.85, 0.85))
        axes.axis("off")
        _draw_kept(axes)
        _draw_stages(axes)
        _draw_uses(axes)
        figure.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})
        for path in sys.argv[1:]:
            figure.savefig(path, dpi=110)


def _row(number: int) -> float:
    return -ROW * number - 0.62


def _column(number: int) -> float:
    return FIRST_COLUMN + COLUMN * number


def _box(axes: Axes, x: float, y: float, size: tuple[float, float], fill: str, edge: str) -> None:
    """Draw a box with round corners around a centre."""
    corner = (x - 0.5 * size[0], y - 0.5 * size[1])
    axes.add_patch(
        FancyBboxPatch(
            corner,
            *size,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=fill,
            edgecolor=edge,
            linewidth=1.0,
        )
    )


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], bend: str = "arc3") -> None:
    style = {"arrowstyle": "-|>", "color": PALE, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops={**style, "connectionstyle": bend}, zorder=0)


def _draw_stages(axes: Axes) -> None:
    left, middle = 0.55, 0.55 + 0.5 * STAGE_WIDTH
    for number, (name, what, files) in enumerate(STAGES):
        y = _row(number)
        _box(axes, middle, y, (STAGE_WIDTH, STAGE_HEIGHT), "#f6f8fa", LINE)
        axes.text(left + 0.12, y + 0.2, name, fontsize=10.5, fontweight="bold", color=INK, va="center")
        axes.text(left + 0.12, y - 0.03, what, fontsize=8.2, color=INK, va="center")
        axes.text(
            left + 0.12,
            y - 0.25,
            "   ".join(files),
            fontsize=6.6,
            family="monospace",
            color=PALE,
            va="center",
        )
    for number, text in enumerate(PASSED):
        top, bottom = _row(number - 1) - 0.5 * STAGE_HEIGHT, _row(number) + 0.5 * STAGE_HEIGHT
        _arrow(axes, (left + 0.45, top - 0.02), (left + 0.45, bottom + 0.02))
        axes.text(
            left + 0.62, 0.5 * (top + bottom), text, fontsize=8.2, style="italic", color=PALE, va="center"
        )
    side = left - 0.02
    _arrow(axes, (side, _row(2)), (side, _row(1)), "bar,fraction=-0.2")
    axes.text(
        0.12, _row(1.5), "again, at the matched pose", fontsize=7.6, style="italic", color=PALE, rotation=90,
        ha="center", va="center",
    )  # fmt: skip


def _draw_kept(axes: Axes) -> None:
    end = _row(len(STAGES)) + 0.42
    for number, (name, file) in enumerate(KEPT):
        x = _column(number)
        _arrow(axes, (x, 0.0), (x, end))
        _box(axes, x, 0.2, (CHIP_WIDTH, 0.52), "#eef1f4", LINE)
        axes.text(x, 0.29, name, fontsize=9.5, fontweight="bold", color=INK, ha="center", va="center")
        axes.text(x, 0.08, file, fontsize=6.6, family="monospace", color=PALE, ha="center", va="center")
    axes.text(
        _column(1.5), end - 0.13, "kept for the next scan", fontsize=8.2, style="italic", color=PALE, ha="center",
        va="center",
    )  # fmt: skip
    axes.text(
        _column(1.5),
        0.68,
        "what outlives a scan",
        fontsize=8.2,
        style="italic",
        color=PALE,
        ha="center",
        va="center",
    )


def _draw_uses(axes: Axes) -> None:
    for stage, kept, kind, text in USES:
        fill, edge = COLORS[kind]
        x, y = _column(kept), _row(stage)
        _box(axes, x, y, (CHIP_WIDTH, 0.68), fill, edge)
        axes.text(x, y + 0.21, kind, fontsize=7.4, fontweight="bold", color=edge, ha="center", va="center")
        axes.text(x, y - 0.09, text, fontsize=7.6, color=INK, ha="center", va="center", linespacing=1.15)


if __name__ == "__main__":
    main()
