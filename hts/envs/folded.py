"""Any TorchRL env of batch size [P·N], such as TorchRL's wrappers of other libraries give,
in the shape that hts trains on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv, VecGymEnvTransform

from hts.channels import Channel
from hts.envs.specs import FLAGS, make_specs
from hts.errors import ConfigError, PluginError, unknown_name
from hts.rl.task_env import TaskEnv

Key = str | tuple[str, ...]
LONGEST_STEP = 1.0  # s
ChannelValues = Callable[[TensorDictBase, torch.Tensor], Mapping[str, torch.Tensor]]


class FoldedEnv(TaskEnv):
    """Env instance n of candidate p is instance p·N + n of `inner`. The task is unchanged; what hts needs is added:

    observation, critic_observation: parts of the inner observation, one after the other, float32 [P, N, O];
    reward: the inner one times reward_scale; by default dt, so that a reward per step becomes a rate per second, as
    λ's unit wants. A task that multiplies by its control step itself gets 1;
    ("channels", name): from `values(inner step, action sent)`, both of batch size [P·N]; (P·N, *shape) each.

    inner: has the flags done, terminated, truncated, and resets single worlds (`_reset`); dt: control step, s;
    action_limit: actions are clipped to ± this, for tasks that do not do so themselves. A card of a policy calls the
    parts of the observation by their last name (`observation_layout`). Seeds are the inner env's own affair.
    """

    batch_locked = True

    def __init__(
        self,
        inner: EnvBase,
        num_candidates: int,
        *,
        dt: float,
        observation: Sequence[Key],
        channels: Mapping[str, Channel],
        values: ChannelValues,
        critic_observation: Sequence[Key] = (),
        action_limit: float | None = None,
        reward_scale: float | None = None,
    ) -> None:
        _check_numbers(dt, action_limit)
        worlds = inner.batch_size.numel()
        if len(inner.batch_size) != 1 or worlds % num_candidates:
            raise ConfigError(
                f"An env of batch size {list(inner.batch_size)} cannot be folded for {num_candidates} candidates: "
                "expected [candidates · worlds]."
            )
        shape = torch.Size([num_candidates, worlds // num_candidates])
        super().__init__(device=inner.device or torch.device("cpu"), batch_size=shape)
        self.inner, self.dt, self.values, self.action_limit = inner, dt, values, action_limit
        self.reward_scale = dt if reward_scale is None else reward_scale
        self.wanted = dict(channels)
        self.parts = {"observation": tuple(observation), "critic_observation": tuple(critic_observation or observation)}
        self._check_inner()
        self.observation_layout = [  # for the card of a policy that is trained here
            {"name": key if isinstance(key, str) else key[-1], "size": self._size(key)}
            for key in self.parts["observation"]
        ]
        seen = {name: sum(self._size(key) for key in keys) for name, keys in self.parts.items()}
        make_specs(self, seen, self.wanted, inner.action_spec.shape[-1])

    def _check_inner(self) -> None:
        """The inner env gives the observations that are asked of it, and the flags."""
        given = {_shown(key) for key in self.inner.observation_spec.keys(True, True)}
        for part, keys in self.parts.items():
            for key in keys:
                if _shown(key) not in given:
                    text = unknown_name("entry of the inner env's observation_spec", _shown(key), given)
                    raise ConfigError(f"FoldedEnv: {part}: {text}")
        if any(isinstance(one, VecGymEnvTransform) and not one.native_autoreset for one in _transforms(self.inner)):
            raise ConfigError(
                "FoldedEnv: the inner env begins episodes anew by itself, so the last observation of each is not "
                "there, and what a time-out is worth would be made of placeholders. Have it wait for a reset: in "
                "gymnasium autoreset_mode=AutoresetMode.DISABLED, or a SerialEnv of one GymWrapper a world."
            )
        flags = set(self.inner.full_done_spec.keys(True, True))
        for name in FLAGS:
            if name not in flags:
                raise ConfigError(
                    f"FoldedEnv: the inner env has no flag '{name}' (it has "
                    f"{', '.join(map(_shown, sorted(flags, key=str)))}). An episode that ends by time is truncated, "
                    "one that ends by failing is terminated, either is done."
                )

    def _size(self, key: Key) -> int:
        return math.prod(self.inner.observation_spec[key].shape[1:])

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        flat = None
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118 - a TensorDict
            mask = tensordict["_reset"].reshape(-1, 1)
            flat = TensorDict({"_reset": mask}, [mask.shape[0]], device=self.inner.device)
        action = torch.zeros(self.batch_size.numel(), self.action_spec.shape[-1], device=self.device)
        return self._folded(self.inner.reset(flat), action)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].flatten(0, 1)
        if self.action_limit is not None:
            action = action.clamp(-self.action_limit, self.action_limit)
        sent = action.to(self.inner.action_spec.dtype)
        after = self.inner.step(TensorDict({"action": sent}, [len(sent)], device=self.inner.device))["next"]
        result = self._folded(after, action)
        result["reward"] = after["reward"].float().view(*self.batch_size, 1) * self.reward_scale
        return result

    def _folded(self, flat: TensorDictBase, action: torch.Tensor) -> TensorDict:
        shape = self.batch_size
        found = self.values(flat, action)
        channels = {name: self._channel(found, channel) for name, channel in self.wanted.items()}
        entries: dict[str, Any] = {
            name: torch.cat([flat[key].float().view(*shape, -1) for key in keys], -1)
            for name, keys in self.parts.items()
        }
        entries |= {name: flat[name].view(*shape, 1).clone() for name in FLAGS}
        entries["channels"] = TensorDict(channels, shape, device=self.device)
        return TensorDict(entries, shape, device=self.device)

    def _channel(self, found: Mapping[str, torch.Tensor], channel: Channel) -> torch.Tensor:
        """One of the channels that `values` gave, [P, N, *shape] float32.
        Raises PluginError if it is not there or is odd."""
        if not isinstance(found, Mapping):
            raise PluginError(f"FoldedEnv: values() gives a {type(found).__name__}, expected a mapping name -> tensor.")
        if channel.name not in found:
            raise PluginError("FoldedEnv: values(): " + unknown_name("channel", channel.name, found))
        tensor, worlds = found[channel.name], self.batch_size.numel()
        if not isinstance(tensor, torch.Tensor):
            raise PluginError(f"FoldedEnv: values()['{channel.name}'] is a {type(tensor).__name__}, expected a tensor.")
        if tensor.shape[:1] != (worlds,) or tensor.numel() != worlds * math.prod(channel.shape):
            raise PluginError(
                f"FoldedEnv: values()['{channel.name}'] has shape {tuple(tensor.shape)}, expected "
                f"{(worlds, *channel.shape)}: worlds of all candidates first, then the channel's own shape."
            )
        return tensor.float().reshape(*self.batch_size, *channel.shape)

    def _set_seed(self, seed: int | None) -> None:
        """Worlds are seeded when they are made."""

    def close(self, **kwargs: Any) -> None:
        if not self.inner.is_closed:
            self.inner.close()
        super().close(**kwargs)


def _transforms(env: EnvBase) -> Iterator[Transform]:
    """Of an env and of those that it is around."""
    while isinstance(env, TransformedEnv):
        yield from env.transform if isinstance(env.transform, Compose) else (env.transform,)
        env = env.base_env


def _check_numbers(dt: float, action_limit: float | None) -> None:
    """Raises ConfigError for a control step that is none, and for a limit that is no number above 0."""
    if not isinstance(dt, int | float) or not 0 < dt <= LONGEST_STEP:
        raise ConfigError(
            f"FoldedEnv: dt is {dt}, expected the control step in s, above 0 and up to {LONGEST_STEP:g} (not in ms)."
        )
    if action_limit is not None and not (isinstance(action_limit, int | float) and action_limit > 0):
        raise ConfigError(
            f"FoldedEnv: action_limit is {action_limit}, expected one number above 0, to which all actions are clipped "
            "both ways, or None."
        )


def _shown(key: Key) -> str:
    """A key of a TensorDict as one word: "state" or "state/position"."""
    return key if isinstance(key, str) else "/".join(key)
