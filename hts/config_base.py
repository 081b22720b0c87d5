"""What all configuration sections have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, dataclass_transform, get_args

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
)


def _no_nan(found: float) -> float:
    if math.isnan(found):
        raise ValueError("is not a number")
    return found


def _in_order(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("expected two numbers, the smaller one first")
    return ends


SEEDS = 2**63
"""Seeds are whole numbers from 0 to below this: what random generators and their states hold."""

MayBeEndless = Annotated[float, AllowInfNan(True), AfterValidator(_no_nan)]
"""A number that may be infinite (.inf), where that has a meaning of its own, such as no bound; never NaN."""


Range = Annotated[tuple[float, float], AfterValidator(_in_order)]
"""(low, high) of a uniform distribution; both may be one number, which is then what everyone gets."""


# A type checker without pydantic's plugin takes `Field(0.5, …)` for a field that must be given: as no field specifier,
# it is what it is here, a default.
@dataclass_transform(kw_only_default=True)
class Config(BaseModel):
    """Base of all configuration sections: frozen, unknown keys refused, numbers finite where a field does not say that
    it is `MayBeEndless`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _true_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        """pydantic takes true for 1."""
        given = value if isinstance(value, (list, tuple)) else (value,)
        if any(isinstance(one, bool) for one in given) and info.field_name in cls.model_fields:
            kinds = _kinds(cls.model_fields[info.field_name].annotation)
            said = any(isinstance(one, bool) for one in kinds)  # Literal[False]
            if kinds & {int, float} and not kinds & {bool, Any} and not said:
                raise ValueError("expected a number" if float in kinds else "expected a whole number")
        return value


def _kinds(annotation: Any) -> set[Any]:
    """The types that an annotation is made of."""
    inner = get_args(annotation)
    return set().union(*map(_kinds, inner)) if inner else {annotation}


def percent(share: float) -> int:
    """A share, 1, in whole percent."""
    return round(100 * share)


def shares_of(whole: str, shares: tuple[float, ...]) -> tuple[float, ...]:
    """Checks shares of a whole ("training") after which candidates are named. Raises ValueError."""
    for share in shares:
        if not 0.0 < share < 1.0:
            raise ValueError(f"{share:g} is no share of the {whole}; give numbers between 0 and 1")
    percents = [percent(share) for share in shares]
    if not all(0 < one < 100 for one in percents) or len(set(percents)) < len(percents):
        raise ValueError("each share names its candidates by its percent, so give different ones from 0.01 to 0.99")
    return shares


@dataclass(frozen=True)
class NameOrFile:
    """Beside a setting's type, as in `Annotated[str, NameOrFile(".json")]`: it is a name, or a path, which ends in
    `suffix` or has a / in it."""

    suffix: str

    def is_file(self, given: str) -> bool:
        return given.endswith(self.suffix) or "/" in given


class Named(BaseModel):
    """A plugin by name, with settings that its own factory validates."""

    model_config = ConfigDict(frozen=True, extra="allow")
    name: str = Field(description="as `hts plugins` lists it")

    if TYPE_CHECKING:  # `extra="allow"` is nothing that a type checker knows

        def __init__(self, *, name: str, **settings: Any) -> None: ...

    @property
    def settings(self) -> dict[str, Any]:
        return dict(self.model_extra or {})
