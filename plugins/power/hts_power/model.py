"""Measurement model `battery_current`: torque, speed and their products, to what the battery's gauge shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from hts.contracts import MeasurementModel, ModelContext
from hts.measurement.lstm import LSTM, LSTMSettings


class BatteryCurrentSettings(LSTMSettings):
    """Settings of measurement model `battery_current`: those of `lstm`, with products."""

    products: bool = Field(
        True, description="give the model τ², τq̇ and q̇² beside τ and q̇; false: the paper's inputs alone"
    )


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """An LSTM: the gauge averages, and shows a current late."""
    return LSTM(BatteryCurrentSettings.model_validate(dict(settings)), context.signals)
