"""Panels that the paper's figures are made of; drawn with matplotlib's objects, without pyplot."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.common import Options, say
from slammot_graph.core import se2
from slammot_graph.core.results import GridMap, StepResult
from slammot_graph.core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 110
SIGMAS_95 = 2.4477
"""Radius of the 95% ellipse in the plane [standard deviations]."""
COLORS = {"truth": "#2f9e44", "estimate": "#1c5fd4", "odometry": "#c98a1b", "moving": "#d42a2a"}


def panels(n_rows: int, n_columns: int, size_in: tuple[float, float]) -> tuple["Figure", "list[list[Axes]]"]:
    """Make a figure with a grid of panels of that size each."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(
        figsize=(size_in[0] * n_columns, size_in[1] * n_rows),
        dpi=DPI,
        layout="constrained",
        facecolor="white",
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots(n_rows, n_columns, squeeze=False)
    return figure, [list(row) for row in axes]


def save(figure: "Figure", name: str, options: Options) -> Path:
    """Write ``figures/<name>.png``; the same content gives the same bytes."""
    path = options.folder("figures") / f"{name}.png"
    figure.savefig(path, metadata={"Software": None})
    say(f"{name}: {path}")
    return path


def draw_map(axes: "Axes", grid: GridMap, view: Sequence[float]) -> None:
    """Occupied cells black, free ones white, unknown ones grey; `view` is x_min, x_max, y_min, y_max [m]."""
    with np.errstate(invalid="ignore"):
        shade = np.where(grid.p_occupied > 0.8, 0.1, np.where(grid.p_occupied < 0.2, 1.0, 0.87))
    height, width = grid.resolution_m * np.array(grid.p_occupied.shape)
    x, y = grid.origin
    axes.imshow(
        shade,
        cmap="gray",
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=(x, x + width, y, y + height),
        interpolation="nearest",
    )
    axes.set(xlim=view[:2], ylim=view[2:], aspect="equal", facecolor="0.87")
    axes.tick_params(labelsize=7)


def draw_path(axes: "Axes", positions: FloatArray, what: str, *, dashed: bool = False) -> None:
    """A trajectory in the colour of what it is."""
    axes.plot(*positions[:, :2].T, "--" if dashed else "-", color=COLORS[what], linewidth=1.2, label=what)


def draw_ellipses(axes: "Axes", step: StepResult, T_map_base: FloatArray, every: int = 3) -> None:
    """End points of one scan with their 95% ellipses; moving ones red."""
    from matplotlib.patches import Ellipse

    points = step.scan.points(T_map_base)
    for k in np.flatnonzero(step.is_valid):
        color = COLORS["moving" if step.is_moving[k] else "estimate"]
        axes.plot(*points[k], ".", color=color, markersize=3)
        cov = step.point_cov_map[k]
        if (k % every and not step.is_moving[k]) or not np.isfinite(cov).all():
            continue
        values, vectors = np.linalg.eigh(cov)
        width, height = 2.0 * SIGMAS_95 * np.sqrt(np.maximum(values, 0.0))
        angle = np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))
        axes.add_patch(Ellipse(points[k], width, height, angle=angle, fill=False, color=color, linewidth=0.6))
    axes.plot(*T_map_base[:2], "^", color=COLORS["truth"], markersize=6)


def view_of(points: FloatArray, margin_m: float = 0.4) -> tuple[float, float, float, float]:
    """x_min, x_max, y_min, y_max that hold all points."""
    low, high = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def aligned(T_map_base: FloatArray, T_world_map: FloatArray) -> FloatArray:
    """A trajectory in the world."""
    return se2.compose(T_world_map[None, :], T_map_base)
