"""Registers what this package offers. Imports nothing heavy: factories import what they make when they are called."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hts import hookimpl

if TYPE_CHECKING:
    from collections.abc import Callable

    from hts.contracts import Instrument, MeasurementModel, ModelContext, Objective, Robot, Settings

HTS_API = 2


def make_noise(settings: Settings) -> Objective:
    """Objective `noise`: walk more quietly, as a microphone beside the track hears it."""
    from hts_noise.objective import Noise, NoiseSettings

    return Noise(NoiseSettings.model_validate(dict(settings)))


def make_footfall_level(settings: Settings, context: ModelContext) -> MeasurementModel:
    """Measurement model `footfall_level`: an LSTM on joint speeds, foot forces and their squares."""
    from hts_noise import model

    return model.make(settings, context)


def make_microphone(settings: Settings, robot: Robot) -> Instrument:
    """Instrument `microphone`: what a sound-level meter beside a simulated robot shows."""
    from hts_noise import microphone

    return microphone.make_microphone(settings, robot)


@hookimpl
def hts_objectives(register: Callable[[str, Callable[..., Objective]], None]) -> None:
    register("noise", make_noise)


@hookimpl
def hts_measurement_models(register: Callable[[str, Callable[..., MeasurementModel]], None]) -> None:
    register("footfall_level", make_footfall_level)


@hookimpl
def hts_instruments(register: Callable[[str, Callable[..., Instrument]], None]) -> None:
    register("microphone", make_microphone)
