"""A reward term of a measured quantity, for managers as mjlab and Isaac Lab have them; knows neither of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from hts_rsl_rl.errors import ModelFileError
from hts_rsl_rl.measurement import Measured, MeasurementModel
from hts_rsl_rl.multiplier import RunningMean

CENTRING = 2e-3  # beta per control step: about that of one update of 0.05 per batch of 24 steps
Channel = Callable[[Any], Tensor]
"""From the env to values (W, ...) of a channel, in its unit."""


class MeasuredTerm:
    """r_real - centre of each world, per second, with a memory per world that is emptied where an episode begins.

    The manager multiplies with its weight, which is lambda, and with the control step. The centre is a running mean
    over steps and worlds (`RunningMean`, beta = centring per step; None: not centred), which takes out what every new
    fit moves: the zero of z-scores. A reward that is not finite stops the training with the env instance named: some
    managers would make 0 of it, and 0 is the best that a cost can be.

    model: file; num_envs, device, step_seconds: of the env; channels: name of each input -> values from the env.
    """

    def __init__(
        self,
        model: str,
        num_envs: int,
        device: torch.device | str,
        step_seconds: float,
        channels: Mapping[str, Channel],
        centring: float | None = CENTRING,
    ) -> None:
        self.model = MeasurementModel(model, device)
        self.seen: Measured | None = None
        """What the last step gave."""
        rate = 1.0 / step_seconds
        if abs(rate - self.model.rate_hz) > 1e-3 * self.model.rate_hz:
            raise ModelFileError(
                f"{model}: predicts at {self.model.rate_hz:g} Hz, this env steps at {rate:g} Hz. Set decimation and "
                "timestep to the robot's control rate, or fit a model to recordings of this one."
            )
        missing = [one.name for one in self.model.inputs if one.name not in channels]
        if missing:
            raise ModelFileError(
                f"{model}: reads '{missing[0]}', and nothing says where that is in this env. Say it in params: "
                f'channels={{"{missing[0]}": function of the env that gives it in {self._unit(missing[0])}}}. Known: '
                f"{', '.join(sorted(channels)) or 'none'}."
            )
        self.channels = {one.name: channels[one.name] for one in self.model.inputs}
        self.state = self.model.initial_state(num_envs)
        self.centre = None if centring is None else RunningMean(centring, device)

    def _unit(self, name: str) -> str:
        return next(one.unit for one in self.model.inputs if one.name == name)

    @torch.no_grad()
    def reset(self, env_ids: Tensor | Sequence[int] | slice | None = None) -> None:
        """New episodes in these instances; all where None."""
        begun = torch.zeros(len(self.state), dtype=torch.bool, device=self.state.device)
        begun[slice(None) if env_ids is None else env_ids] = True
        self.state = self.model.reset(self.state, begun)

    @torch.no_grad()
    def __call__(self, env: Any) -> Tensor:
        """The term after a control step, (W,)."""
        parts = []
        for one in self.model.inputs:
            values = self.channels[one.name](env)
            if not values.ndim or len(values) != len(self.state):
                raise ModelFileError(
                    f"{self.model.path}: '{one.name}' has the shape {tuple(values.shape)} in this env; expected "
                    f"{len(self.state)} env instances first, then {one.size} numbers each. Turn it round in params."
                )
            values = values.reshape(len(self.state), -1).float()
            if values.shape[1] != one.size:
                raise ModelFileError(
                    f"{self.model.path}: '{one.name}' has {one.size} numbers, this env gives {values.shape[1]}. Say in "
                    "params which joints, in the order of the recordings: joint_names=(...)."
                )
            parts.append(values)
        self.seen, self.state = self.model.step(torch.cat(parts, 1), self.state)
        reward = self.seen.reward
        if not bool(torch.isfinite(reward).all()):
            worst = int((~torch.isfinite(reward)).nonzero()[0])
            raise ModelFileError(
                f"{self.model.path}: the reward of env instance {worst} is {reward[worst].item()}. Its inputs are not "
                "finite: the simulation of that instance has failed. End such episodes before rewards are computed."
            )
        if self.centre is None:
            return reward.clone()
        self.centre.update(reward.mean())
        return reward - self.centre.mean


class ManagedTerm:
    """What a `MeasuredReward` is to a manager: made with cfg and env, called with the params by their names.

    params: model, the exported file; entity, whose joints; joint_names, theirs in the order of the recordings, None: as
    the file says; channels, name -> function of the env, for inputs that are not torque, velocity and position of
    joints, or that are to be read in another way; centring, beta per control step, None for none.
    """

    def __init__(self, cfg: Any, env: Any, fields: Mapping[str, str]) -> None:
        """fields: as in `term_of`."""
        self.term = term_of(cfg.params, env, fields)

    def reset(self, env_ids: Tensor | Sequence[int] | slice | None = None) -> None:
        """New episodes in these instances; all where None."""
        self.term.reset(env_ids)

    def __call__(
        self,
        env: Any,
        model: str = "",
        entity: str = "robot",
        joint_names: Sequence[str] | None = None,
        channels: Mapping[str, Channel] | None = None,
        centring: float | None = CENTRING,
    ) -> Tensor:
        """The params were read when the term was made; managers want them named here."""
        return self.term(env)


def term_of(params: Mapping[str, Any], env: Any, fields: Mapping[str, str]) -> MeasuredTerm:
    """The term that a manager's params ask for. Raises ModelFileError.

    params: as in `ManagedTerm`; env: has num_envs,
    device, step_dt and scene; fields: name of a channel -> field of the entity's data, one number a joint.
    """
    given = {"entity": "robot", "joint_names": None, "channels": None, "centring": CENTRING, **params}
    own = dict(given["channels"] or {})
    model = MeasurementModel(given["model"])
    inputs = [one.name for one in model.inputs]
    for name in own:
        if name not in inputs:
            raise ModelFileError(
                f"{given['model']}: params say where '{name}' is in this env, which the model does not read; it reads "
                f"{', '.join(inputs)}. Correct the name in channels, or leave it out."
            )
    read = [one.name for one in model.inputs if one.name in fields and one.name not in own]
    if read:
        entity = env.scene[given["entity"]]
        order = joint_order(given["model"], given["joint_names"], model.joint_names, entity.joint_names)
        places = torch.tensor(order, device=env.device)
        own = {**{name: _field(entity.data, fields[name], places) for name in read}, **own}
    return MeasuredTerm(given["model"], env.num_envs, env.device, env.step_dt, own, given["centring"])


def _field(data: Any, name: str, places: Tensor) -> Channel:
    """A field of an entity's joints, in another order; what is read is that of the present step."""
    return lambda _: getattr(data, name)[:, places]


def joint_order(path: str, given: Sequence[str] | None, model: Sequence[str] | None, known: Sequence[str]) -> list[int]:
    """Where in the env's joints those of the recordings are, in their order. Raises ModelFileError: an order is never
    guessed.

    given: by the user; model: by the file; known: the env's, in its order.
    """
    names = given or model
    if not names:
        raise ModelFileError(
            f"{path}: does not say in which order its joints are. Say it in params, joint_names=(...), as the "
            "recordings have them (`hts data show`), or export it again with --robot NAME."
        )
    missing = [name for name in names if name not in known]
    if missing:
        raise ModelFileError(
            f"{path}: joint '{missing[0]}' is not in this env, which has {', '.join(known)}. Say in params how the "
            "joints are called here, in the order of the recordings: joint_names=(...)."
        )
    twice = next((name for place, name in enumerate(names) if name in names[:place]), None)
    if twice is not None:
        raise ModelFileError(
            f"{path}: joint '{twice}' is named twice in the order of the joints, {', '.join(names)}. Say each joint of "
            "the recordings once: joint_names=(...)."
        )
    return [list(known).index(name) for name in names]
