"""Registers what this package offers. Imports nothing heavy: factories import what they make when they are called."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hts import hookimpl

if TYPE_CHECKING:
    from collections.abc import Callable

    from hts.contracts import Instrument, MeasurementModel, ModelContext, Objective, Robot, Settings

HTS_API = 2


def make_power(settings: Settings) -> Objective:
    """Objective `power`: battery power, from the current that the battery's own gauge shows."""
    from hts_power.objective import Power, PowerSettings

    return Power(PowerSettings.model_validate(dict(settings)))


# `paper`: the stand-in's λ reach to both sides of the one that won there (docs/decisions.md).
# `paper-exact`: the paper's inputs, model and criterion; the rest of its protocol is the preset's own.
PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"baseline_weights": [2e-2, 6e-2, 0.15, 0.4]},
    "paper-exact": {
        "weights": [0.5, 1.0, 5.0],
        "baseline_weights": [5e-5, 1e-4, 5e-4, 1e-3, 5e-3],
        "products": False,
        "criterion": "net",
        "model": {"name": "battery_current", "products": False},
    },
}


def make_battery_current(settings: Settings, context: ModelContext) -> MeasurementModel:
    """Measurement model `battery_current`: an LSTM on torque, speed and their products."""
    from hts_power import model

    return model.make(settings, context)


def make_drive_train(settings: Settings, context: ModelContext) -> MeasurementModel:
    """Measurement model `drive_train`: the terms of the drives' power, shared between joints built alike."""
    from hts_power import drive_train_model

    return drive_train_model.make(settings, context)


def make_battery_gauge(settings: Settings, robot: Robot) -> Instrument:
    """Instrument `battery_gauge`: drive train, shared bus, battery and gauge of a simulated robot."""
    from hts_power.gauge import make_gauge

    return make_gauge(settings, robot)


def make_calibrate_twin() -> Callable[..., Any]:
    """Command `calibrate-twin`: the table of the simulated robot against its calibration anchors."""
    from hts_power.calibration import calibrate_twin

    return calibrate_twin


@hookimpl
def hts_objectives(register: Callable[..., None]) -> None:
    register("power", make_power, presets=PRESETS)


@hookimpl
def hts_measurement_models(register: Callable[[str, Callable[..., MeasurementModel]], None]) -> None:
    register("battery_current", make_battery_current)
    register("drive_train", make_drive_train)


@hookimpl
def hts_instruments(register: Callable[[str, Callable[..., Instrument]], None]) -> None:
    register("battery_gauge", make_battery_gauge)


@hookimpl
def hts_commands(register: Callable[[str, Callable[..., Callable[..., Any]]], None]) -> None:
    register("calibrate-twin", make_calibrate_twin)
