"""Ranges of configuration values: declared in the type of each field, checked when a configuration is made.

``n_sigma: Positive = 2.448`` refuses what is not positive, NaN and infinity included.
"""

import dataclasses
import functools
import math
import typing
from dataclasses import dataclass
from typing import Annotated, Any

from slammot_graph.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Range:
    """Numbers that a field may have; NaN is in none.

    Attributes
    ----------
    low, high : float
    is_low_open, is_high_open : bool
        The limit itself is left out.
    may_be_infinite : bool
        Infinity is in a range without an upper limit.
    """

    low: float = -math.inf
    high: float = math.inf
    is_low_open: bool = False
    is_high_open: bool = False
    may_be_infinite: bool = False

    def __contains__(self, value: float) -> bool:
        is_above = value > self.low if self.is_low_open else value >= self.low
        is_below = value < self.high if self.is_high_open else value <= self.high
        return is_above and is_below and (abs(value) < math.inf or self.may_be_infinite)

    def __str__(self) -> str:
        if math.isfinite(self.high) and math.isfinite(self.low):
            brackets = "(" if self.is_low_open else "[", ")" if self.is_high_open else "]"
            return f"in {brackets[0]}{self.low:g}, {self.high:g}{brackets[1]}"
        if self.low == -math.inf:
            return "finite"
        if self.low == 0.0:
            return "positive" if self.is_low_open else "not negative"
        return f"at least {self.low:g}"

    def refusal(self, value: float) -> str:
        """Say why a value that is not in the range is refused."""
        if not self.may_be_infinite and math.isinf(value) and value > self.low:
            return f"must be finite, not {value}"
        return f"must {'not be negative' if str(self) == 'not negative' else f'be {self}'}, not {value}"


Positive = Annotated[float, Range(low=0.0, is_low_open=True)]
PositiveOrInfinite = Annotated[float, Range(low=0.0, is_low_open=True, may_be_infinite=True)]
NotNegative = Annotated[float, Range(low=0.0)]
Share = Annotated[float, Range(low=0.0, high=1.0)]
PositiveShare = Annotated[float, Range(low=0.0, high=1.0, is_low_open=True)]
AtLeastOne = Annotated[float, Range(low=1.0)]
Count = Annotated[int, Range(low=1)]
CountOrZero = Annotated[int, Range(low=0)]


class FieldError(ConfigError):
    """A value that a configuration does not allow.

    Attributes
    ----------
    key : str
        Path of the field below the configuration that was made; empty for several fields at once.
    problem : str
        What is wrong, to be read after the field's path.
    """

    def __init__(self, problem: str, *, key: str = "", owner: str = "") -> None:
        super().__init__(f"{'.'.join(filter(None, (owner, key)))} {problem}")
        self.key = key
        self.problem = problem


class Checked:
    """Base of configurations whose fields declare what they may be.

    A configuration with more to check overrides ``__post_init__``, calls this one first and then `require`.
    """

    def __post_init__(self) -> None:
        """Check each field against its declaration.

        Raises
        ------
        FieldError
            A value out of its range, or none of its choices.
        """
        owner = type(self).__name__
        for name, allowed in _declared(type(self)):  # type: ignore[arg-type]  # classes are hashable
            value = getattr(self, name)
            if isinstance(allowed, Range):
                if isinstance(value, int | float) and value not in allowed:
                    raise FieldError(allowed.refusal(value), key=name, owner=owner)
            elif value not in allowed:
                choices = " or ".join(map(repr, allowed))
                raise FieldError(f"must be {choices}, not {value!r}", key=name, owner=owner)

    def require(self, holds: bool, problem: str, key: str = "") -> None:
        """Refuse a configuration for what several of its fields say together.

        Raises
        ------
        FieldError
        """
        if not holds:
            raise FieldError(problem, key=key, owner=type(self).__name__)


@functools.cache
def _declared(cls: type[Any]) -> tuple[tuple[str, Range | tuple[Any, ...]], ...]:
    """Give the fields of a configuration with the range or the choices of each."""
    hints = typing.get_type_hints(cls, include_extras=True)
    found = ((field.name, _allowed(hints[field.name])) for field in dataclasses.fields(cls))
    return tuple((name, allowed) for name, allowed in found if allowed is not None)


def _allowed(hint: Any) -> Range | tuple[Any, ...] | None:
    """Give the range or the choices that a type declares; plain numbers must be finite."""
    if hint is float:
        return Range()
    if typing.get_origin(hint) is Annotated:
        return next((item for item in typing.get_args(hint)[1:] if isinstance(item, Range)), None)
    if typing.get_origin(hint) is typing.Literal:
        return typing.get_args(hint)
    for option in typing.get_args(hint):  # "float | None": None is no number and passes
        if isinstance(allowed := _allowed(option), Range):
            return allowed
    return None
