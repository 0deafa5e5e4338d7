"""Why a beam was called moving or not: the numbers in `StepResult.reason` index `REASONS`."""

(
    NOT_VALID, OCCUPIED, UNKNOWN, FREE, TOO_UNCERTAIN, DISCARDED, ABSTAINED, TRACKED, NOT_TESTED, VACATED, FURNITURE,
    ALONG, TOO_WIDE, UNSUPPORTED, COME_UP,
) = range(15)  # fmt: skip

REASONS = (
    "no valid return",
    "static: an occupied cell under the ellipse",
    "static: an unknown cell under the ellipse",
    "moving: only free cells under the ellipse",
    "static: the ellipse is too large to decide",
    "static: free cells only, but its cluster is too small or too wide",
    "static: too much of the scan seemed to move, or the match failed",
    "moving: where a tracked object was expected, and no occupied cell",
    "static: this method makes no test",
    "moving: beside a place where something stood a moment ago that is empty now, and no occupied cell",
    "static: free cells only, but most of its cluster lies where static points lay before",
    "moving: on a small thing that alone pulls the match away from the odometry",
    "neither: free cells only, and wider than a person; kept out of the map as long as the cells are known to be free",
    "neither: free cells only, but so is too much of the scan, or the match failed; kept out of the map as those",
    "neither: as what is wider than a person, but away from all walls, or goes on from what is on free cells, and not"
    " in line with a wall; kept out of the match as well",
)
NOT_MAPPED = (TOO_WIDE, UNSUPPORTED, COME_UP)
"""Neither moving nor static."""
