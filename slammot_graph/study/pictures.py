"""Maps and walkers of a study's scenarios, method by method, in the panels of the paper's figures."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.run import Run
from slammot_graph.simulation import SimulatedLog, simulate
from slammot_graph.study.measures import config_of
from slammot_graph.study.plan import Planned
from slammot_graph.study.results import replaced

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 110
COLORS = {"truth": "#2f9e44", "estimate": "#1c5fd4", "odometry": "#c98a1b", "moving": "#d42a2a"}


def draw_pictures(rows: Sequence[Planned], methods: Sequence[str], folder: Path) -> list[Path]:
    """Draw ``pictures/<world>.png`` for each scenario: the first seed, a column for each of the methods.

    What is drawn already is left as it is.
    """
    drawn = []
    for world in dict.fromkeys(row.world for row in rows if "scenario" in row.cell.arguments):
        first = {row.method: row for row in reversed(rows) if row.world == world and not row.override}
        chosen = [first[method] for method in methods if method in first]
        path = folder / "pictures" / f"{world.replace('/', ' ')}.png"
        if chosen and _mark(path) != _address(chosen):
            path.parent.mkdir(parents=True, exist_ok=True)
            _draw(chosen, path)
        if chosen:
            drawn.append(path)
    return drawn


def _draw(chosen: Sequence[Planned], path: Path) -> None:
    """Draw map, true path, wheels and estimate (the paper's Fig. 1, 5, 7) above people and tracks (Fig. 6, 8)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    arguments = chosen[0].cell.arguments
    log = simulate(arguments["scenario"], seed=arguments["seed"], **arguments["options"])
    figure = Figure(figsize=(4.0 * len(chosen), 6.6), dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(chosen), squeeze=False)
    for column, row in enumerate(chosen):
        result = Run(log, config=config_of(row.cell.arguments["config"])).complete()
        error = absolute_error(result.T_map_base, log.T_world_base)
        T_map_world = se2.inverse(error.T_world_map)
        T_true = se2.compose(T_map_world[None, :], log.T_world_base)
        for panel in (axes[0][column], axes[1][column]):
            _draw_map(panel, result, T_true)
        _paths(axes[0][column], result, T_true)
        axes[0][column].set_title(f"{row.method}: ATE {error.translation_m.rmse:.3f} m", fontsize=9)
        _people(axes[1][column], result, log, T_map_world)
    for line in axes:
        line[-1].legend(fontsize=6, loc="lower right")
    with replaced(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None, "Description": _address(chosen)})


def _draw_map(panel: "Axes", result: RunResult, T_true: FloatArray) -> None:
    grid = result.grid
    with np.errstate(invalid="ignore"):
        shade = np.where(grid.p_occupied > 0.8, 0.1, np.where(grid.p_occupied < 0.2, 1.0, 0.87))
    height, width = grid.resolution_m * np.array(grid.p_occupied.shape)
    x, y = grid.origin
    panel.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=(x, x + width, y, y + height))
    rows, columns = np.nonzero(np.nan_to_num(grid.p_occupied) > 0.8)
    cells = grid.origin + grid.resolution_m * np.column_stack([columns, rows])
    seen = np.vstack(
        [np.percentile(cells, [0.5, 99.5], axis=0) if len(cells) else T_true[:, :2], T_true[:, :2]]
    )
    low, high = seen.min(axis=0) - 0.5, seen.max(axis=0) + 0.5
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
    panel.tick_params(labelsize=7)


def _paths(panel: "Axes", result: RunResult, T_true: FloatArray) -> None:
    for name, poses, style in (
        ("odometry", result.T_map_odom_base, "-"),
        ("truth", T_true, "-"),
        ("estimate", result.T_map_base, "--"),
    ):
        panel.plot(*poses[:, :2].T, style, color=COLORS[name], linewidth=1.2, label=name)


def _people(panel: "Axes", result: RunResult, log: SimulatedLog, T_map_world: FloatArray) -> None:
    """Where the people were who were seen, and where the tracks are."""
    seen = np.array([np.isin(np.arange(log.objects.shape[1]), ids) for ids in log.object_id])
    frames, people = np.nonzero(seen.reshape(len(log.stamps), -1))
    places = se2.transform(T_map_world, log.objects[frames, people, :2].reshape(-1, 2))
    panel.plot(*places.T, ".", color=COLORS["truth"], markersize=3, label="people, truth")
    panel.plot(*result.tracks[:, 2:4].T, ".", color=COLORS["moving"], markersize=2, label="people, tracked")


def _address(chosen: Sequence[Planned]) -> str:
    return hashlib.sha256(" ".join(row.cell.digest for row in chosen).encode()).hexdigest()[:32]


def _mark(path: Path) -> str | None:
    """The address that a picture was drawn with."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return str(image.info.get("Description"))
    except (OSError, UnidentifiedImageError):
        return None
