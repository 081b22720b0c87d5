"""Measurement model `footfall_level`: joint speeds, foot forces and their squares, to the level that a meter shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from hts.contracts import MeasurementModel, ModelContext
from hts.measurement.lstm import LSTM, LSTMSettings


class FootfallLevelSettings(LSTMSettings):
    """Settings of measurement model `footfall_level`: those of `lstm`, smaller and with products."""

    hidden: int = Field(32, ge=1, description="units per layer")
    products: bool = Field(True, description="give the model q̇² and F² beside q̇ and F")


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """An LSTM: the meter averages over 125 ms, and a step is heard for longer than the foot's impact lasts."""
    return LSTM(FootfallLevelSettings.model_validate(dict(settings)), context.signals)
