"""Draw ``how_it_works.svg``: one scan's path through the pipeline, with the files and what they share.

Run it from anywhere: ``python docs/how_it_works.py``. Rows are the stages, columns what is kept from scan to scan.
"""

import sys
from pathlib import Path
from textwrap import fill

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

STAGES = (
    ("0  read", "a scan, with its odometry if there is any, from a log or a live source",
     ("logs/registry.py", "core/scan.py", "run.py", "pipeline.py")),
    ("1  predict", "last pose and calibrated odometry, or the previous motion; plus R_r",
     ("localization/scan_to_map.py", "odometry/propagation.py", "odometry/adaptive.py", "odometry/history.py",
      "odometry/previous_motion.py", "odometry/noise.py")),
    ("2  detect", "an ellipse on free cells only: moving; clusters",
     ("detection/ellipse_detector.py", "detection/ellipse_test.py", "detection/visibility_check.py",
      "detection/clustering.py")),
    ("3  match", "static points onto lines, robust, also against the prediction; p_moving",
     ("localization/map_matching.py", "registration/point_to_line.py", "detection/probability.py")),
    ("4  graph", "a keyframe becomes a node, smoothed by ISAM2; odometry is calibrated",
     ("localization/lost_detector.py", "localization/graph_insertion.py", "localization/keyframe_state.py",
      "graph/local_factors.py", "graph/pose_graph.py", "mapping/local_map.py", "odometry/calibration.py")),
    ("5  close loops", "whenever a local map is finished; the scan is attached to its node",
     ("loop_closure/submap.py", "loop_closure/detector.py", "loop_closure/verification.py",
      "loop_closure/relocalization.py", "localization/scan_poses.py")),
    ("6  map", "static points occupy, all beams free what they cross",
     ("mapping/occupancy_grid.py",)),
    ("7  objects", "clusters of moving points become tracks",
     ("tracking/tracker.py", "detection/scan_history.py")),
    ("8  report", "to the observers; after the last scan the backward pass and the verdict",
     ("localization/health.py", "core/results.py", "observer.py", "detection/backward_pass.py", "diagnosis/verdict.py",
      "run_folder/writer.py")),
)  # fmt: skip
"""Name, what it does, files within the package in the order in which a scan meets them: none is named twice."""

PASSED = (
    "",
    "scan, odometry",
    "predicted pose and its covariance",
    "is_moving, a label for each beam",
    "matched pose, its covariance, converged or not",
    "now and then: a finished local map",
    "matched pose, which points are static",
    "matched pose, clusters of moving points",
    "StepResult",
    "the run folder",
)
"""What goes into each stage from the one above; the last comes out."""

KEPT = ("occupancy grid", "local maps", "pose graph", "tracks")
"""What outlives a scan."""

READ, WRITE = "reads", "writes"
USES = (
    (1, 2, READ, "covariance relative\nto the anchor"),
    (2, 0, READ, "free, occupied\nand unknown cells"),
    (2, 3, READ, "predicted positions"),
    (3, 1, READ, "points and normals"),
    (4, 2, WRITE, "odometry factor (R_r),\nmatch factor"),
    (4, 1, WRITE, "a keyframe"),
    (5, 1, READ, "finished local maps"),
    (5, 2, WRITE, "closure factors"),
    (6, 0, WRITE, "hits and passes"),
    (7, 3, WRITE, "position, velocity"),
)
"""Stage, what is kept, read or written, and what of it."""

COLORS = {READ: ("#e7f0fd", "#1c5fd4"), WRITE: ("#fdeee0", "#b35309")}
INK, PALE, LINE = "#1f2328", "#59636e", "#c4cad1"
ROW, STAGE_WIDTH, STAGE_HEIGHT = 1.32, 4.55, 0.98
FILE_COLUMNS = 80
FIRST_COLUMN, COLUMN, CHIP_WIDTH = 6.2, 1.78, 1.62


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


def _box(axes: Axes, x: float, y: float, size: tuple[float, float], paper: str, edge: str) -> None:
    """Draw a box with round corners around a centre."""
    corner = (x - 0.5 * size[0], y - 0.5 * size[1])
    axes.add_patch(
        FancyBboxPatch(
            corner,
            *size,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=paper,
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
        axes.text(left + 0.12, y + 0.33, name, fontsize=10.5, fontweight="bold", color=INK, va="center")
        axes.text(left + 0.12, y + 0.11, what, fontsize=8.2, color=INK, va="center")
        axes.text(
            left + 0.12,
            y - 0.2,
            fill("  ".join(files), FILE_COLUMNS, break_on_hyphens=False),
            fontsize=6.6,
            family="monospace",
            color=PALE,
            va="center",
            linespacing=1.3,
        )
    for number, text in enumerate(PASSED):
        if not text:
            continue
        top, bottom = _row(number - 1) - 0.5 * STAGE_HEIGHT, _row(number) + 0.5 * STAGE_HEIGHT
        _arrow(axes, (left + 0.45, top - 0.02), (left + 0.45, bottom + 0.02))
        axes.text(
            left + 0.62, 0.5 * (top + bottom), text, fontsize=8.2, style="italic", color=PALE, va="center"
        )
    side = left - 0.02
    _arrow(axes, (side, _row(3)), (side, _row(2)), "bar,fraction=-0.2")
    axes.text(
        0.12, _row(2.5), "again, at the matched pose", fontsize=7.6, style="italic", color=PALE, rotation=90,
        ha="center", va="center",
    )  # fmt: skip


def _draw_kept(axes: Axes) -> None:
    end = _row(len(STAGES)) + 0.42
    for number, name in enumerate(KEPT):
        x = _column(number)
        _arrow(axes, (x, 0.0), (x, end))
        _box(axes, x, 0.2, (CHIP_WIDTH, 0.52), "#eef1f4", LINE)
        axes.text(x, 0.2, name, fontsize=9.5, fontweight="bold", color=INK, ha="center", va="center")
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
        paper, edge = COLORS[kind]
        x, y = _column(kept), _row(stage)
        _box(axes, x, y, (CHIP_WIDTH, 0.68), paper, edge)
        axes.text(x, y + 0.21, kind, fontsize=7.4, fontweight="bold", color=edge, ha="center", va="center")
        axes.text(x, y - 0.09, text, fontsize=7.6, color=INK, ha="center", va="center", linespacing=1.15)


if __name__ == "__main__":
    main()
