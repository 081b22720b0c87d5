"""What all configuration sections have in common."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Config(BaseModel):
    """Base of all configuration sections: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Named(BaseModel):
    """A plugin by name, with settings that its own factory validates."""

    model_config = ConfigDict(frozen=True, extra="allow")
    name: str = Field(description="as `hts plugins` lists it")

    @property
    def settings(self) -> dict[str, Any]:
        return dict(self.model_extra or {})
