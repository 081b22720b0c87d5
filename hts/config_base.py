"""What all configuration sections have in common."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Config(BaseModel):
    """Base of all configuration sections: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


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


class Named(BaseModel):
    """A plugin by name, with settings that its own factory validates."""

    model_config = ConfigDict(frozen=True, extra="allow")
    name: str = Field(description="as `hts plugins` lists it")

    @property
    def settings(self) -> dict[str, Any]:
        return dict(self.model_extra or {})
