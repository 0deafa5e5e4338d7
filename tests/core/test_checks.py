import math
from dataclasses import dataclass
from typing import Literal

import pytest

from slammot_graph.core.checks import (
    Checked,
    Count,
    CountOrZero,
    FieldError,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    PositiveShare,
    Share,
)


@dataclass(frozen=True, kw_only=True)
class Limits(Checked):
    positive: Positive = 1.0
    or_infinite: PositiveOrInfinite = 1.0
    not_negative: NotNegative = 0.0
    share: Share = 0.0
    positive_share: PositiveShare = 1.0
    count: Count = 1
    or_zero: CountOrZero = 0
    plain: float = -1.0
    maybe: Positive | None = None
    mode: Literal["a", "b"] = "a"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(self.count >= self.or_zero, "needs or_zero <= count")


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("positive", 0.0, "must be positive, not 0.0"),
        ("positive", math.nan, "must be positive, not nan"),
        ("positive", math.inf, "must be finite, not inf"),
        ("positive", -math.inf, "must be positive, not -inf"),
        ("or_infinite", math.nan, "must be positive, not nan"),
        ("or_infinite", -math.inf, "must be positive, not -inf"),
        ("not_negative", -0.1, "must not be negative, not -0.1"),
        ("not_negative", math.nan, "must not be negative, not nan"),
        ("share", 1.1, "must be in [0, 1], not 1.1"),
        ("positive_share", 0.0, "must be in (0, 1], not 0.0"),
        ("count", 0, "must be at least 1, not 0"),
        ("or_zero", -1, "must not be negative, not -1"),
        ("plain", math.nan, "must be finite, not nan"),
        ("plain", math.inf, "must be finite, not inf"),
        ("maybe", 0.0, "must be positive, not 0.0"),
        ("mode", "c", "must be 'a' or 'b', not 'c'"),
    ],
)
def test_what_a_field_does_not_declare_is_refused(name: str, value: float, problem: str) -> None:
    with pytest.raises(FieldError) as caught:
        Limits(**{name: value})  # type: ignore[arg-type]
    assert str(caught.value) == f"Limits.{name} {problem}"
    assert (caught.value.key, caught.value.problem) == (name, problem)


def test_what_a_field_declares_is_taken() -> None:
    Limits(positive=1e-300, or_infinite=math.inf, share=1, positive_share=0.1, count=7, maybe=2.0, mode="b")
    Limits(not_negative=0, plain=-1e300)


def test_what_several_fields_say_together_is_checked_after_each() -> None:
    with pytest.raises(FieldError, match=r"^Limits needs or_zero <= count$") as caught:
        Limits(or_zero=2)
    assert caught.value.key == ""
