"""The colours of recordings and pictures, as 0xRRGGBBAA: a thing has one colour wherever it is shown."""

COLOR_ESTIMATE = 0x0072B2FF
COLOR_ODOMETRY = 0xE69F00FF
COLOR_TRUTH = 0x009E73FF
COLOR_STATIC = 0x2F6FB5FF
COLOR_MOVING = 0xE3342FFF
COLOR_MOVED = 0xF29B94FF
"""Of the moving points of scans gone by."""
COLOR_NEW = 0xD55E00FF
"""Of what stands where a saved map saw nothing ..."""
COLOR_GONE = 0x56B4E9FF
"""... and of what it showed and is there no more."""
COLOR_CLOSURE = 0xCC33AAFF
COLOR_MATCH = 0x56B4E9FF
COLOR_BEFORE = 0x8C564BFF
TRACK_COLORS = (
    0x00A65CFF,
    0x5E2A84FF,
    0x7A4E00FF,
    0x62AEB8FF,
    0x600030FF,
    0x9C88E4FF,
    0x6E7014FF,
    0x1F4E44FF,
    0xA8607CFF,
)
"""Of tracks, which cross trajectory, odometry, closures and moving points: apart from all of these, in
simulated red-green blindness too (CIEDE2000 of 11 or more; among each other 7)."""
RUN_COLORS = (
    0x0072B2FF,
    0xD55E00FF,
    0xCC79A7FF,
    0x7B3FA0FF,
    0xE6B800FF,
    0x56B4E9FF,
    0x8C564BFF,
    0x444444FF,
)
"""Of several runs in one recording; none of them is that of the truth."""


def track_color(track_id: int) -> int:
    """Colour of a track, the same wherever it is shown."""
    return TRACK_COLORS[track_id % len(TRACK_COLORS)]


def to_hex(rgba: int) -> str:
    """Write a colour as matplotlib reads it, ``#rrggbbaa``."""
    return f"#{rgba:08x}"
