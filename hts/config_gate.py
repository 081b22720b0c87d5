"""The section `gate` of a run's configuration: what a candidate must bear in simulation before a machine gets it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from hts.config_base import Config, Range, shares_of

Check = Literal["torque", "joint_range", "action_rate", "tilt"]


class FirstRunConfig(Config):
    """How the first run of a new policy on a machine is made gentle; the deploy bundle states it."""

    speed_scale: float = Field(0.5, gt=0, le=1, description="factor on every commanded speed, or set-point")
    torque_scale: float = Field(0.7, ge=0.1, le=1, description="factor on each joint's torque limit")
    seconds: float = Field(20.0, gt=0, le=600, description="length of the first run of each policy, s")


class GateConfig(Config):
    """Elites are tried over varied dynamics before they are tried for real; docs/safety.md argues each default."""

    enabled: bool = Field(True, description="false: only who fell while being judged is kept from a machine")
    strict: bool | None = Field(
        None,
        description="keep from the world who fails, or fell while being judged; false: say it and try them; null: "
        "strict where the world may be a machine",
    )
    num_envs: int = Field(16, ge=1, description="env instances per policy and set-point, each with its own dynamics")
    seconds: float = Field(5.0, ge=2.0, description="length of each trial, s")
    friction: Range = Field((0.3, 1.3), description="sliding friction of the floor, 1")
    payload: Range = Field((-1.0, 3.0), description="added to the trunk, kg")
    gains: Range = Field((0.8, 1.2), description="factor on kp and kd of each joint, 1")
    latency: Range = Field((0.0, 1.0), description="of the actions, as a share of a control step, 1")
    lost_packets: Range = Field((0.0, 0.05), description="share of actions that never arrive, 1")
    torque_level: float = Field(0.9, gt=0, le=1, description="share of a torque limit that counts as reaching it")
    torque_share: float = Field(0.1, ge=0, lt=1, description="largest share of the time that a joint may be there")
    joint_margin: float = Field(0.05, ge=0, description="smallest distance of a joint from its position limits, rad")
    action_rate: float = Field(
        0.75, gt=0, description="largest rate of a joint's target, root mean square, as a share of its velocity limit"
    )
    tilt: float = Field(25.0, gt=0, le=180, description="largest angle of the trunk from upright, degrees")
    accept_untold: tuple[Check, ...] = Field(
        (), description="checks that this robot's env cannot tell and for which a person vouches on a machine"
    )
    nearer: tuple[float, ...] = Field(
        (),
        description="with `strict`, where nobody of an iteration may be tried: shares of the way from anchor to "
        "candidate, between 0 and 1, at which each is judged and tried here once more",
    )
    nearer_for: Literal["nobody", "first"] = Field(
        "nobody",
        description="when `nearer` is done. nobody: where nobody of an iteration may be tried; first: also where whom "
        "the selector would name first may not, for those that are kept from the world",
    )
    first_run: FirstRunConfig = Field(default_factory=FirstRunConfig, description="of a policy on a machine")

    @field_validator("nearer")
    @classmethod
    def _shares_of_the_way(cls, shares: tuple[float, ...]) -> tuple[float, ...]:
        return shares_of("way", shares)

    @field_validator("friction", "gains")
    @classmethod
    def _above_zero(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not ends[0] > 0:
            raise ValueError(f"{ends[0]:g} is not above 0")
        return ends

    @field_validator("latency", "lost_packets")
    @classmethod
    def _shares(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not (ends[0] >= 0 and ends[1] <= 1):
            raise ValueError(f"{list(ends)} are not shares from 0 to 1")
        return ends
