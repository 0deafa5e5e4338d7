"""A moving picture of a run: its map, and scan by scan the points, the objects and the path so far.

What stands still is drawn once; for each frame only what moves is drawn over it.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.saved_run import RunFolder, end_points, scans_of
from slammot_graph.core.scan import Scan
from slammot_graph.core.stamps import STAMP_TOLERANCE_S, nearest_stamps
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.logs import LaserLog
from slammot_graph.viz.colors import (
    COLOR_ESTIMATE,
    COLOR_MOVING,
    COLOR_STATIC,
    TRACK_COLORS,
    to_hex,
    track_color,
)
from slammot_graph.viz.drawing import (
    MAX_MAP_IN,
    TEXT_PT,
    TITLE_PT,
    UNKNOWN,
    Entry,
    add_map_axes,
    draw_legend,
    draw_map,
    draw_scale_bar,
    draw_title,
    find_limits,
    lay_out,
    line_artist,
    line_entry,
    state_entries,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation
    from PIL.Image import Image as PillowImage

Kind = Literal["gif", "mp4"]
Picture = npt.NDArray[np.uint8]

DPI = 125
FAINT_COLORS = np.array([[236, 238, 240], [255, 255, 255], [165, 168, 172]], dtype=np.uint8)
"""Of the map's cells: unknown, free, occupied."""
TRAIL_SCANS = 30
"""So many scans long is the trail of a moving object."""
ROBOT_LENGTH = 0.035
"""Length of the robot's arrow as a share of the map's long side."""
RING_PT = 8.0
"""Diameter of the ring around a moving object."""
POINT: dict[str, Any] = {"linestyle": "", "marker": ".", "markeredgewidth": 0.0}
PATH: dict[str, Any] = {"color": to_hex(COLOR_ESTIMATE), "linewidth": 1.0}
N_GIF_COLORS = 255
UNCHANGED = 255
"""Index of the colour of a GIF that lets the frame before shine through."""
N_BLENDS = 6
"""Steps from each colour that moves to the paper's; the smooth edges of points and lines need them."""


def write_animation(
    folder: RunFolder,
    log: LaserLog,
    path: str | Path,
    *,
    kind: Kind,
    rows: range,
    fps: float,
    tell: Callable[[int], None] = lambda _: None,
) -> None:
    """Draw a run as a moving picture.

    Parameters
    ----------
    folder : RunFolder
    log : LaserLog
        The log of that run; the points are not in the folder.
    path : str or Path
        The file, whatever its suffix.
    kind : "gif" or "mp4"
        An mp4 needs the program ffmpeg, or the package imageio-ffmpeg that brings it.
    rows : range
        Which scans of the run are shown, a frame each.
    fps : float
        Frames per second.
    tell : callable
        Told how many frames are done.

    Raises
    ------
    InputError
        The log is not that of the run, or ffmpeg is not there or fails.
    OSError
        The file cannot be written.
    """
    stage = _Stage(folder, log_name=log.path.name)

    def frames() -> Iterator[Picture]:
        for n, (row, scan) in enumerate(_chosen(scans_of(folder, log), rows), start=1):
            yield stage.draw(row, scan)
            tell(n)

    if kind == "gif":
        _write_gif(Path(path), frames(), fps, stage.colors())
    else:
        _write_mp4(Path(path), frames(), fps, stage.size)


def _chosen(scans: Iterator[Scan], rows: range) -> Iterator[tuple[int, Scan]]:
    for row, scan in enumerate(scans):
        if row in rows:
            yield row, scan
        if row >= rows[-1]:
            return


class _Stage:
    """The picture: what stands still as pixels, and the artists that move."""

    def __init__(self, folder: RunFolder, *, log_name: str) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.patches import Polygon

        self._folder = folder
        page = lay_out(find_limits(folder.T_map_base, folder.grid), self._legend())
        figure = Figure(figsize=(page.width_in, page.height_in), dpi=DPI, facecolor="white")
        self._canvas = FigureCanvasAgg(figure)
        self._axes = axes = add_map_axes(figure, page, FAINT_COLORS[UNKNOWN])
        draw_map(axes, folder.grid, max_cells=max(MAX_MAP_IN) * DPI, colors=FAINT_COLORS)
        draw_scale_bar(axes, page)
        title = f"{folder.method} on {log_name}"
        draw_title(figure, page, title, above_in=0.24, size_pt=TITLE_PT, weight="bold")

        # in the order in which they are drawn
        (self._static,) = axes.plot([], [], **POINT, color=to_hex(COLOR_STATIC), markersize=4.0)
        self._tracks = _TrackArtists(axes, folder)
        (self._moving,) = axes.plot([], [], **POINT, color=to_hex(COLOR_MOVING), markersize=5.5)
        (self._path,) = axes.plot([], [], **PATH)
        self._robot = Polygon(np.zeros((4, 2)), facecolor=PATH["color"], edgecolor="white", linewidth=0.6)
        axes.add_patch(self._robot)
        self._clock = draw_title(figure, page, "", above_in=0.08, size_pt=TEXT_PT)
        self._clock.set_color("0.25")
        self._moving_artists: list[Artist] = [
            *(self._static, self._tracks.trails, self._moving, self._path, self._robot),
            *(self._tracks.places, self._clock),
        ]
        for artist in self._moving_artists:
            artist.set_animated(True)
        draw_legend(figure, page)
        self._robot_m = ROBOT_LENGTH * max(page.limits.size_m)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        self._background = self._canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self._canvas.get_width_height()

    def draw(self, row: int, scan: Scan) -> Picture:
        """Draw a scan of the run as an (height, width, 3) array."""
        folder = self._folder
        points, is_moving = end_points(folder, row, scan)
        self._static.set_data(*points[~is_moving].T)
        self._moving.set_data(*points[is_moving].T)
        self._path.set_data(*folder.T_map_base[: row + 1, :2].T)
        arrow = self._robot_m * np.array([[0.6, 0.0], [-0.4, 0.35], [-0.2, 0.0], [-0.4, -0.35]])
        self._robot.set_xy(se2.transform(folder.T_map_base[row], arrow))
        self._tracks.show(row)
        time_s = folder.stamps[row] - folder.stamps[0]
        self._clock.set_text(f"{time_s:.1f} s   scan {row + 1} of {len(folder.stamps)}")
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        for artist in (*self._moving_artists, *self._tracks.ids):
            self._axes.draw_artist(artist)
        return self._pixels()

    def _pixels(self) -> Picture:
        return np.array(self._canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]

    def _legend(self) -> list[list[Entry]]:
        """Say what everything in the picture is: the scan, the robot, the objects, the map."""
        static = line_entry("points that stand still", **POINT, color=to_hex(COLOR_STATIC), markersize=5.0)
        moving = line_entry("points that move", **POINT, color=to_hex(COLOR_MOVING), markersize=6.0)
        robot = line_entry("robot and its path", **PATH, marker=">", markersize=6.0, markeredgecolor="white")
        rings = [
            line_artist(
                color=to_hex(color), marker="o", markersize=5.0, markerfacecolor="none", linewidth=1.0
            )
            for color in TRACK_COLORS[:2]
        ]
        track = Entry(tuple(rings), f"tracked objects, and their paths in the last {TRAIL_SCANS} scans")
        has_map = bool(np.isfinite(self._folder.grid.p_occupied).any())
        free, *others = state_entries(FAINT_COLORS)
        states = [free._replace(label=f"finished map: {free.label}"), *others] if has_map else []
        return [[static, moving, robot], [track] if len(self._folder.tracks) else [], states]

    def colors(self) -> Picture:
        """Give (256, 3) colours that do for all frames: those of what stands still, and of what moves."""
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        still = self._pixels().reshape(-1, 3)
        moving = [COLOR_STATIC, COLOR_MOVING, COLOR_ESTIMATE, *self._tracks.of_scans.colors(), 0x404040FF]
        shown = np.array([[color >> shift & 255 for shift in (24, 16, 8)] for color in moving])
        share = np.linspace(1.0, 0.2, N_BLENDS)[:, None, None]
        blends = np.round(share * shown + (1.0 - share) * 255.0).astype(np.uint8).reshape(-1, 3)
        kinds, counts = np.unique(still, axis=0, return_counts=True)
        kinds = kinds[np.argsort(-counts)]
        # of colours that are nearly equal the most frequent one: Pillow does not tell them apart
        _, distinct = np.unique(kinds >> 3, axis=0, return_index=True)
        kept = kinds[np.sort(distinct)][: N_GIF_COLORS - len(blends)]
        colors = np.concatenate([kept, blends])
        return np.concatenate([colors, np.repeat(colors[-1:], N_GIF_COLORS - len(colors), axis=0)])


class _TracksOfScans:
    """The tracks of a run by its scans."""

    def __init__(self, folder: RunFolder) -> None:
        found = nearest_stamps(folder.stamps, folder.tracks[:, 0], STAMP_TOLERANCE_S)
        is_known = found >= 0
        rows: IntArray = found[is_known]
        by_row = np.argsort(rows, kind="stable")
        self._rows = rows[by_row]
        self._tracks = folder.tracks[is_known][by_row]

    def trails(self, row: int) -> dict[int, FloatArray]:
        """Give for each object of a scan its last places (k, 2) [m], that of the scan last."""
        first, start, end = np.searchsorted(self._rows, [row - TRAIL_SCANS, row, row + 1])
        recent = self._tracks[first:end]
        ids = self._tracks[start:end, 1].astype(np.int64).tolist()
        return {track_id: recent[recent[:, 1] == track_id, 2:4] for track_id in ids}

    def colors(self) -> list[int]:
        """Give the colours of all objects, each once."""
        ids = np.unique(self._tracks[:, 1].astype(np.int64)).tolist()
        return list(dict.fromkeys(track_color(track_id) for track_id in ids))


class _TrackArtists:
    """What is drawn of the tracks: a trail, a ring and a number for each."""

    def __init__(self, axes: "Axes", folder: RunFolder) -> None:
        from matplotlib.collections import LineCollection

        self.of_scans = _TracksOfScans(folder)
        self.trails = LineCollection([], linewidths=1.0)
        axes.add_collection(self.trails, autolim=False)
        self.places = axes.scatter([], [], s=RING_PT**2, facecolors="none", linewidths=1.0)
        self.ids: list[Annotation] = []
        self._axes = axes

    def show(self, row: int) -> None:
        """Show the objects of a scan: the path behind each, and its number beside it."""
        trails = self.of_scans.trails(row)
        self.trails.set_segments(list(trails.values()))
        colors = [to_hex(track_color(track_id)) for track_id in trails]
        self.trails.set_color(colors)
        self.places.set_offsets(np.array([trail[-1] for trail in trails.values()]).reshape(-1, 2))
        self.places.set_edgecolor(colors)
        while len(self.ids) < len(trails):
            text = self._axes.annotate(
                "", (0.0, 0.0), xytext=(5, 5), textcoords="offset points", fontsize=TEXT_PT, fontweight="bold"
            )
            text.set(animated=True, clip_on=True)
            self.ids.append(text)
        for text in self.ids[len(trails) :]:
            text.set_visible(False)
        for text, (track_id, trail), color in zip(self.ids, trails.items(), colors, strict=False):
            text.set(text=str(track_id), color=color, visible=True)
            text.xy = trail[-1]


# ----------------------------------------------------------------------------------------------------- writers


def _write_gif(path: Path, frames: Iterator[Picture], fps: float, colors: Picture) -> None:
    """Write a GIF that begins anew at its end, all frames in the same colours; each holds what has changed."""
    from PIL import Image

    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate([colors, colors[:1]]).tobytes())

    def reduced() -> "Iterator[PillowImage]":
        before: Picture | None = None
        for frame in frames:
            picture = Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
            indices = np.asarray(picture)
            indices = np.where(indices == UNCHANGED, 0, indices).astype(np.uint8)
            changed = indices if before is None else np.where(indices == before, UNCHANGED, indices)
            before = indices
            shown = Image.fromarray(changed.astype(np.uint8))
            shown.putpalette(palette.getpalette() or [])  # which makes its grey values indices
            yield shown

    pictures = reduced()
    first = next(pictures)
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=pictures,
        duration=max(20, round(100.0 / fps) * 10),  # [ms]; a GIF counts in hundredths of a second
        loop=0,
        optimize=False,
        disposal=1,
        transparency=UNCHANGED,
    )


def _write_mp4(path: Path, frames: Iterator[Picture], fps: float, size: tuple[int, int]) -> None:
    command = [
        *(find_ffmpeg(), "-y", "-loglevel", "error"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-"),
        *("-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-c:v", "libx264", "-pix_fmt", "yuv420p"),
        *("-movflags", "+faststart", "-f", "mp4", str(path.absolute())),
    ]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
        _feed(process, frames)
        if process.returncode != 0:
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines() or ["it says nothing"]
            raise InputError(f"{command[0]} failed: {lines[-1]}; name a .gif as --output")


def _feed(process: "subprocess.Popen[bytes]", frames: Iterator[Picture]) -> None:
    """Send the frames; where ffmpeg has ended before, its exit code and words tell why."""
    with suppress(BrokenPipeError), process:  # which closes the pipe and waits
        for frame in frames:
            assert process.stdin is not None
            process.stdin.write(frame.tobytes())


def find_ffmpeg() -> str:
    """Find the program ffmpeg: on the path, or that of the package imageio-ffmpeg.

    Raises
    ------
    InputError
        There is none.
    """
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        bundled: str = import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise InputError(
            "an .mp4 needs ffmpeg, which is not installed; name a .gif as --output, or pip install imageio-ffmpeg"
        ) from None
    return bundled
