"""What the recordings of one run and of several share: where they go, how maps and views are made.

Rerun is imported only when something is recorded.
Everything in the map frame lies at z = 0 but for small offsets that order the layers.
"""

import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import FloatArray, IntArray

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

MAP_HEIGHT_M = -0.05
"""Maps lie below all else."""
EYE_DISTANCE = 1.03
"""How far the viewer's eye must be to see a metre from below to above, with a little to spare [m]."""
MIN_FRAME_M = 5.0
COLOR_UNKNOWN = (112, 137, 134)
"""Around the map, as the viewer colours its unknown cells."""
DARKER = 0.94
"""How much darker than its neighbours every other cell is."""


class Sink:
    """A stream of rerun and where it goes: a file, or a viewer that is opened.

    Parameters
    ----------
    name : str
        The application's name in the viewer; a layout is kept under it.
    path : Path or None
        The recording to write.
    spawn : bool
        Open a viewer and stream to it instead; exactly one of `path` and `spawn`.
    recording_id : str, optional
        The viewer joins recordings that have the same.

    Raises
    ------
    InputError
        The file cannot be written or no viewer can be opened.
    """

    def __init__(self, name: str, *, path: Path | None, spawn: bool, recording_id: str | None = None) -> None:
        import rerun as rr

        if (path is None) != spawn:
            raise ValueError("give either a path or spawn=True")
        self._target = f"the recording {path}" if path is not None else "the rerun viewer"
        self._remedy = (
            "free some space, choose another folder or pass --rerun off"
            if path is not None
            else "a viewer needs a display and the rerun of this environment; pass --rerun file instead"
        )
        batching = rr.ChunkBatcherConfig(flush_tick=0.2 if spawn else 5.0, flush_num_bytes=4 << 20)
        self.rec = rr.RecordingStream(name, recording_id=recording_id, batcher_config=batching)
        with self.errors():
            if path is not None:
                self.rec.save(path)
            else:
                executable = viewer_executable()
                rr.spawn(recording=self.rec, executable_path=str(executable) if executable else None)
                self.rec.flush(timeout_sec=10.0)
            self.rec.set_log_time_enabled(False)

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Turn what rerun or the disk says into one line."""
        try:
            yield
        except (RuntimeError, OSError) as error:
            lines = str(error).strip().splitlines() or [type(error).__name__]
            raise InputError(f"cannot write {self._target}: {lines[0]}; {self._remedy}") from error

    def log_text(self, path: str, text: str) -> None:
        """Log a Markdown text that holds at all times."""
        import rerun as rr

        self.rec.log(path, rr.TextDocument(text, media_type="text/markdown"), static=True)

    def flush(self) -> None:
        """Wait until all is written."""
        with self.errors():
            self.rec.flush(timeout_sec=60.0)


def viewer_executable() -> Path | None:
    """Give the viewer of this environment, or else the one on the path; None where there is none."""
    own = Path(sys.executable).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
    if own.exists():
        return own
    found = shutil.which("rerun")
    return None if found is None else Path(found)


class Times:
    """Scan indices and stamps of a batch, as columns of both timelines.

    Parameters
    ----------
    index : (n,) int array
    stamps : (n,) array [s]
    """

    def __init__(self, index: IntArray, stamps: FloatArray) -> None:
        self._index = index
        self._stamps = stamps

    def __getitem__(self, rows: "Sequence[int] | IntArray") -> "Times":
        return Times(self._index[rows], self._stamps[rows])

    def columns(self) -> "list[rr.TimeColumn]":
        """Give the columns of the timelines `scan` and `stamp`."""
        import rerun as rr

        nanoseconds = np.round(self._stamps * 1e9).astype(np.int64).view("datetime64[ns]")
        return [rr.TimeColumn("scan", sequence=self._index), rr.TimeColumn("stamp", timestamp=nanoseconds)]


# ----------------------------------------------------------------------------------------------------- entities


def at_height(xy: FloatArray, z: float) -> Any:
    """Planar points (..., 2) as float32 (..., 3) at a height [m]."""
    xyz = np.empty((*xy.shape[:-1], 3), dtype=np.float32)
    xyz[..., :2] = xy
    xyz[..., 2] = z
    return xyz


def yaw_quaternion(yaw: FloatArray) -> Any:
    """Turns about z [rad], (n,), as float32 quaternions x, y, z, w of shape (n, 4)."""
    zero = np.zeros_like(yaw)
    return np.column_stack([zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]).astype(np.float32)


def grid_map(grid: GridMap) -> "rr.GridMap":
    """Make a map that has at least one cell an entity."""
    import rerun as rr

    n_rows, n_cols = grid.p_occupied.shape
    # steps of 5%, which compress well and still show doubt
    percent = np.round(np.nan_to_num(grid.p_occupied, nan=-0.05) * 20.0) * 5.0
    cells = np.where(np.isnan(grid.p_occupied), -1, percent).astype(np.int8)
    return rr.GridMap(
        data=np.flipud(cells).tobytes(),  # its row 0 is the top, ours the lowest y
        format=rr.components.ImageFormat(width=n_cols, height=n_rows, color_model="L", channel_datatype="U8"),
        cell_size=grid.resolution_m,
        translation=[grid.origin[0], grid.origin[1], MAP_HEIGHT_M],
        colormap=rr.components.Colormap.RvizMap,
    )


def cell_colors(grid: GridMap, limits: tuple[float, float], colors: Sequence[int]) -> Any:
    """Colour cells by their state: uint8 (rows, cols, 3); every other one is darker, so that each can be told.

    Parameters
    ----------
    grid : GridMap
    limits : (float, float)
        Below the first probability a cell is free, above the second occupied.
    colors : sequence of int
        0xRRGGBBAA of unknown, free and occupied cells.
    """
    with np.errstate(invalid="ignore"):
        state = 1 * (grid.p_occupied < limits[0]) + 2 * (grid.p_occupied > limits[1])
    # by the cells' numbers in the whole grid, so that the pattern stays where it is while the robot moves
    col, row = np.round(grid.origin / grid.resolution_m).astype(np.int64).tolist()
    is_dark = (row + np.arange(state.shape[0])[:, None] + col + np.arange(state.shape[1])) % 2
    light = np.array([[color >> shift & 0xFF for shift in (24, 16, 8)] for color in colors])
    shades = np.array([light, DARKER * light]).astype(np.uint8)
    return shades[is_dark, state]


def cell_columns(
    colors: Sequence[Any], T_a_corner: FloatArray, resolution_m: Sequence[float], z: float
) -> "rr.ComponentColumnList":
    """Make columns of n coloured grids, one a row.

    Parameters
    ----------
    colors : sequence of (rows, cols, 3) uint8 arrays
        Row 0 is the lowest y.
    T_a_corner : (n, 3) array
        Poses of the lower left corners in the entity's frame a.
    resolution_m : sequence of float
    z : float
        Height [m].
    """
    import rerun as rr

    formats = [
        rr.components.ImageFormat(width=cols, height=rows, color_model="RGB", channel_datatype="U8")
        for rows, cols, _ in (color.shape for color in colors)
    ]
    return rr.GridMap.columns(
        data=[np.flipud(color).tobytes() for color in colors],  # its row 0 is the top, ours the lowest y
        format=formats,
        cell_size=resolution_m,
        translation=at_height(T_a_corner[:, :2], z),
        quaternion=yaw_quaternion(T_a_corner[:, 2]),
    )


# -------------------------------------------------------------------------------------------------------- views


@dataclass(frozen=True, eq=False)
class Frame:
    """What a view from above has to show.

    Attributes
    ----------
    centre : (2,) array [m]
    width_m : float
        Along x.
    height_m : float
        Along y.
    """

    centre: FloatArray
    width_m: float
    height_m: float

    @property
    def extent_m(self) -> float:
        """The longer side."""
        return max(self.width_m, self.height_m)

    @classmethod
    def around(cls, box: FloatArray) -> "Frame":
        """Make that of a low and a high corner (2, 2) [m]."""
        width_m, height_m = (box[1] - box[0]).tolist()
        return cls(0.5 * (box[0] + box[1]), width_m, height_m)

    def eye(self, aspect: float, *, ahead_is_up: bool = False) -> "rrb.EyeControls3D":
        """Look straight down so that it fits a view `aspect` times as wide as it is high; y points up, or else x."""
        import rerun.blueprint as rrb

        across, up = self.width_m, self.height_m
        if ahead_is_up:
            across, up = up, across
        distance_m = EYE_DISTANCE * max(up, across / aspect, MIN_FRAME_M)
        x, y = self.centre.tolist()
        return rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(x, y, distance_m),
            look_target=(x, y, 0.0),
            eye_up=(1.0, 0.0, 0.0) if ahead_is_up else (0.0, 1.0, 0.0),
        )


def view_of(T_map_base: FloatArray, grid: GridMap) -> Frame:
    """Frame the known map and a trajectory (n, 3) of at least one pose."""
    low, high = T_map_base[:, :2].min(axis=0), T_map_base[:, :2].max(axis=0)
    rows, cols = np.nonzero(np.isfinite(grid.p_occupied))
    if len(rows):
        corners = np.array([[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]])
        corners_map = grid.origin + grid.resolution_m * corners
        low, high = np.minimum(low, corners_map[0]), np.maximum(high, corners_map[1])
    return Frame.around(np.array([low, high]))


def view_from_above(
    name: str,
    origin: str,
    contents: list[str],
    eye: "rrb.EyeControls3D",
    overrides: "Mapping[rr.datatypes.EntityPath | str, Any] | None" = None,
) -> "rrb.Spatial3DView":
    """Lay out a view of the plane."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        contents=contents,
        eye_controls=eye,
        overrides=overrides,
        background=COLOR_UNKNOWN,
        line_grid=False,
    )


def until_cursor(n_scans: int | None = None) -> "rrb.VisibleTimeRanges":
    """Show what was logged up to the cursor, of the last `n_scans` or of all."""
    import rerun.blueprint as rrb

    start = (
        rrb.TimeRangeBoundary.infinite()
        if n_scans is None
        else rrb.TimeRangeBoundary.cursor_relative(seq=-n_scans)
    )
    return rrb.VisibleTimeRanges(
        timeline="scan", start=start, end=rrb.TimeRangeBoundary.cursor_relative(seq=0)
    )


def at_all_times() -> "rrb.TimeAxis":
    """Show a whole recording; the viewer's own choice is a part around the cursor."""
    import rerun as rr
    import rerun.blueprint as rrb

    ends = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.encodings.TimeRange(start=ends, end=ends))


def plot_view(
    name: str, group: str, *, top: float | None = None, has_legend: bool = True
) -> "rrb.TimeSeriesView":
    """Lay out a plot of the lines below ``/plots/group`` at all times, from 0 to `top` where that is given."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin=f"/plots/{group}",
        name=name,
        axis_x=at_all_times(),
        axis_y=None if top is None else rrb.ScalarAxis(range=(0.0, top)),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=has_legend),
    )


def plot_pair(name: str, *plots: tuple[str, str], has_legend: bool = True) -> "rrb.Horizontal":
    """Lay out plots of different units, name and group of each, side by side."""
    import rerun.blueprint as rrb

    views = (plot_view(title, group, has_legend=has_legend) for title, group in plots)
    return rrb.Horizontal(*views, name=name)


def collapsed_panels() -> "tuple[rrb.TimePanel, rrb.SelectionPanel, rrb.BlueprintPanel]":
    """Give the panels around the views, all but the time line put away."""
    import rerun.blueprint as rrb

    return (
        rrb.TimePanel(state="collapsed", timeline="scan"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
