"""The objective `power`: walk with less from the battery.

Inputs are joint torque and joint velocity, the target is the current the battery's gauge shows: voltage hardly
moves within a test, so current is the power (paper, section on energy). What counts in the end is measured on the
robot: mean of current times voltage, less what the robot draws with its motors idle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config, Named
from hts.contracts import Comparison, Objective
from hts.errors import EvaluationError
from hts.evaluation.segments import Segments
from hts_power.proxy import JOULE_COEFFICIENT, analytic_power

if TYPE_CHECKING:
    import torch

    from hts.recordings.recording import Recording

GRAVITY = 9.81  # m/s²
VOLTAGE_APART = 5.0
"""A voltage so many times the one while walking, or so small a part of it, is no pack's at idle: one of six cells has
25.2 V when full and 18 when empty, and what walking takes off that is less. Wide, for made-up numbers in tests."""
USUAL_SPREAD = 1 / 3
"""A gauge's standard deviation over the mean net current: 0.25 to 0.63 on sixteen drawn machines (docs/power.md)."""


Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class PowerSettings(Config):
    """Settings of objective `power`."""

    criterion: Literal["smaller", "net"] = Field(
        "smaller",
        description="what a candidate counts with: the smaller of its savings in net power and in cost of "
        "transport (slower walking is no saving), or net power alone as in the paper",
    )
    weights: tuple[Weight, ...] | None = Field(
        None,
        min_length=1,
        description="λ swept, reward per second and standard deviation of the current that the gauge shows; null: as "
        "`net_weights` say",
    )
    net_weights: tuple[Weight, ...] = Field(
        (9.0,),
        min_length=1,
        description="λ swept where `weights` is null, reward per second for all of the net current, behind any gauge",
    )
    baseline_weights: tuple[Weight, ...] = Field(
        (2e-2, 6e-2, 0.15), min_length=1, description="λ that `hts baseline` sweeps, reward per joule of the proxy"
    )
    proxy_weights: tuple[Weight, ...] = Field(
        (6e-2,), min_length=1, description="λ of `hts run --reward proxy`, reward per joule of the proxy"
    )
    joule_coefficient: float = Field(
        JOULE_COEFFICIENT,
        gt=0,
        description="r/k², W/(N·m)², of the analytic proxy, and what the model `drive_train` expects",
    )
    proxy_physics_steps: bool = Field(
        False,
        description="the analytic proxy as its mean over the physics steps of a control step, not once at the end",
    )
    hidden: int = Field(64, ge=1, description="units of the measurement model `battery_current`, which it chooses")
    products: bool = Field(
        True,
        description="give the model `battery_current`, which it chooses, τ², τq̇ and q̇² beside τ and q̇; false: the "
        "paper's inputs alone",
    )


class Power(Objective):
    """Battery power, from battery current.

    λ applies to r_real = −ẑ, where ẑ is the predicted current in standard deviations of the current in the data the
    model was fitted on, per second. So λ = 1 says: one standard deviation less current is worth one unit of reward a
    second, half as much as perfect speed tracking (weight 2 in the velocity task, `hts.envs.rewards`, per second too).
    What one standard deviation is in watts depends on the gauge more than on the robot, so its own λ are said per net
    current (`weights_for`). The zero of ẑ moves with the data too, which reward centring absorbs.
    """

    name = "power"
    unit = "1"
    inputs = ("joint_torque", "joint_velocity")
    target = Channel("battery_current", "A", (), "drawn from the pack, positive when discharging")
    also_measured = (Channel("battery_voltage", "V", (), "of the pack, sum of its cells"),)
    instrument = "battery_gauge"

    def __init__(self, settings: PowerSettings | None = None) -> None:
        self.settings = settings or PowerSettings()
        self.weights = self.settings.weights or tuple(
            _rounded(weight * USUAL_SPREAD) for weight in self.settings.net_weights
        )
        self.baseline_weights, self.proxy_weights = self.settings.baseline_weights, self.settings.proxy_weights

    def measurement_model(self) -> Named:
        """`drive_train`; `battery_current`, of the size that the settings ask for, where they do."""
        asked = self.settings.model_fields_set
        if not {"hidden", "products"} & asked:
            expected = {"joule_coefficient": self.settings.joule_coefficient} if "joule_coefficient" in asked else {}
            return Named(name="drive_train", **expected)
        return Named(name="battery_current", hidden=self.settings.hidden, products=self.settings.products)

    def weights_for(self, spread: float, recordings: Sequence[Recording]) -> tuple[float, ...]:
        """`net_weights` x spread / net current, the mean less idle of first recordings and references; `weights` where
        they are given, or where no recording knows its idle level. spread: of the current, A."""
        name = self.target.name
        known = [one for one in recordings if name in one.idle and one.role in ("collection", "reference")]
        if self.settings.weights is not None or not known:
            return self.weights
        levels = [float(one.values(name).astype(float).mean()) - float(one.idle[name]) for one in known]
        net = float(np.average(levels, weights=[one.num_samples for one in known]))
        if not net > 0:
            return self.weights
        return tuple(_rounded(weight * spread / net) for weight in self.settings.net_weights)

    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """−ẑ, per second; with the analytic proxy, whose prediction is in W, −P."""
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """gross_power W, net_power W and cost_of_transport (J per metre and newton of weight) of each segment. Raises
        EvaluationError for measured segments whose mean net power is not above 0, or whose idle voltage no pack has."""
        current, voltage = segments.values("battery_current"), segments.values("battery_voltage")
        idle_power = segments.idle("battery_current") * segments.idle("battery_voltage")
        gross = mean_power(current, voltage)
        net = gross - idle_power
        if isinstance(segments, Segments) and len(segments):
            _check_level(segments, float(voltage.mean(dtype=float)), segments.idle("battery_voltage"))
        # Here, not in `compare`: all of a policy's segments are a mistake of the idle level, one draw of them is noise.
        if isinstance(segments, Segments) and len(segments) and net.mean() <= 0:
            raise EvaluationError(_below_idle(segments, float(gross.mean()), float(idle_power.mean())))
        return {
            "gross_power": gross,
            "net_power": net,
            "cost_of_transport": net / (segments.mass_kg * GRAVITY * segments.speed),
        }

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """Savings as fractions of the reference's; what a candidate counts with is `settings.criterion`."""
        metrics = {
            "net_reduction": reduction(policy["net_power"], reference["net_power"]),
            "gross_reduction": reduction(policy["gross_power"], reference["gross_power"]),
            "cost_of_transport_reduction": reduction(policy["cost_of_transport"], reference["cost_of_transport"]),
        }
        net = metrics["net_reduction"]
        smaller = min(net, metrics["cost_of_transport_reduction"])
        return Comparison(net, smaller if self.settings.criterion == "smaller" else net, metrics)

    def predicted_channels(self, target: np.ndarray, known: Sequence[Recording]) -> Mapping[str, np.ndarray]:
        """Voltage follows from current: the line through the known recordings' 1 s means, which is the pack's sag at
        the charge it had (V = V_0 - R I). Charge and heat are the same for a policy and its reference."""
        return {"battery_current": target, "battery_voltage": voltage_line(known)(target)}

    @property
    def proxy_in_physics_steps(self) -> bool:
        """As the settings say."""
        return self.settings.proxy_physics_steps

    def proxy(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Yang et al.'s analytic power, W; see `hts_power.proxy`."""
        return analytic_power(channels["joint_torque"], channels["joint_velocity"], self.settings.joule_coefficient)


def _check_level(segments: Segments, walking: float, levels: np.ndarray) -> None:
    """Raise EvaluationError for idle voltages that are far from the one while walking, such as of a point in the wrong
    place or 0 for one that nobody read: idle power is made of them. walking: mean, V."""
    for level in dict.fromkeys(levels.tolist()):
        if not walking / VOLTAGE_APART <= level <= walking * VOLTAGE_APART:
            raise EvaluationError(
                f"A recording of {segments.recordings[0].role} {segments.recordings[0].policy_hash[:8]} says "
                f"battery_voltage is {level:.4g} V idle, and it was {walking:.4g} V in the mean of its walk; "
                f"expected {1 / VOLTAGE_APART:g} to {VOLTAGE_APART:g} times that: a pack sags by some per "
                "cent. Read it off again with electronics on and motors idle, and correct it in the mapping."
            )


def _below_idle(segments: Segments, gross: float, idle: float) -> str:
    who = " and ".join(dict.fromkeys(f"{one.role} {one.policy_hash[:8]}" for one in segments.recordings))
    return (
        f"The {who} drew {gross:.1f} W in the mean and its recordings say {idle:.1f} W idle, {gross - idle:.1f} W net: "
        "expected more than 0 W, or a saving has the wrong sign. Measure the idle levels of battery_current and "
        "battery_voltage again with electronics on and motors idle (the robot lying down, motors unpowered), and give "
        "them with the recordings."
    )


def _rounded(weight: float) -> float:
    """To three digits: λ are read by people."""
    return float(f"{weight:.3g}")


def mean_power(current: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """Mean electrical power over the last axis, W; current A and voltage V on one clock, (..., n) -> (...,)."""
    return (current.astype(float) * voltage.astype(float)).mean(-1)


def voltage_line(recordings: Sequence[Recording]) -> Callable[[np.ndarray], np.ndarray]:
    """Battery voltage, V, as a line in its current, A, by least squares over 1 s means of recordings."""
    pairs = []
    for recording in recordings:
        size = round(recording.rate_hz)
        both = [recording.values(name).reshape(-1) for name in ("battery_current", "battery_voltage")]
        count = len(both[0]) // size
        pairs.append([each[: count * size].reshape(count, size).mean(-1) for each in both])
    current, voltage = (np.concatenate(column).astype(float) for column in zip(*pairs, strict=True))
    spread = current.var()
    slope = float(((current - current.mean()) * (voltage - voltage.mean())).mean() / spread) if spread > 0 else 0.0
    return lambda target: voltage.mean() + slope * (target - current.mean())


def reduction(policy: float, reference: float) -> float:
    """Saving as a fraction of the reference: 0.25 says a quarter less."""
    return 1.0 - policy / reference
