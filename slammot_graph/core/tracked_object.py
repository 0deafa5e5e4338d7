"""What is known of an identity of the final tracks."""

from dataclasses import dataclass
from typing import Literal

ObjectKind = Literal["person", "vehicle", "unknown"]


@dataclass(frozen=True, kw_only=True)
class TrackedObject:
    """What is known of one identity of the final tracks.

    Attributes
    ----------
    track_id : int
    kind : "person", "vehicle" or "unknown" (seen too seldom to tell)
    probability : float
        Of the kind; NaN where unknown.
    size_m : float
        Largest extent across what was seen of it at nine of ten sightings.
    """

    track_id: int
    kind: ObjectKind
    probability: float
    size_m: float
