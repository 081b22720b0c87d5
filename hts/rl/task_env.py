"""What a collector and a trainer may ask of an env beyond TorchRL's `EnvBase`.

`TaskEnv` is any env that trains a population: it has a control step in seconds, and may know how to be saved in
mid-episode. `SplitStepEnv` is one whose control step comes in parts, so that a collector may do per step only what the
next step waits for. Any other TorchRL env works too; it goes through TorchRL's own `Collector`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from hts.rl.random import PopulationRandom
from hts.rl.tracing import any_or_tracing


class TaskEnv(EnvBase):
    """A TorchRL env of batch size [P, N]: P candidates, N env instances each.

    A subclass sets, in its `__init__`, TorchRL's specs: observation_spec, a Composite of what it observes (a population
    reads `observation` [P, N, O] and `critic_observation` [P, N, O_c]); action_spec [P, N, A]; reward_spec [P, N, 1];
    full_done_spec, a Composite of terminated, truncated and done, bool [P, N, 1].

    dt: control step, s, set by each subclass; observation_layout: names and sizes of the parts of `observation`, for
    the card of a policy that is pretrained here, [{"name", "size"}], or None.
    """

    dt: float
    observation_layout: list[dict[str, Any]] | None = None

    def full_state(self) -> TensorDict | None:
        """Everything needed to go on exactly from here; None, the default: this env cannot say, and a training in it
        that is stopped starts again."""
        return None

    def load_full_state(self, state: TensorDictBase) -> None:
        """Go on from `full_state`. Collectors reset the env that they are given, so the next reset of all instances
        has to start no episodes; a `SplitStepEnv` that is told by `go_on` sees to that itself."""
        raise NotImplementedError(f"{type(self).__name__} cannot be saved in mid-episode.")

    def go_on(self, state: TensorDictBase) -> None:
        """What whoever resumes a training calls: `load_full_state`."""
        self.load_full_state(state)

    def check(self) -> None:
        """Raise SimulationError if something in the simulator went wrong since the start, such as a buffer that
        overflowed. May wait for the device: it is called rarely."""


class LaunchedSimulator(ABC):
    """A simulator on a GPU whose step can be launched between captured CUDA graphs: it keeps its memory, and nothing in
    it waits for the host."""

    @abstractmethod
    def load(self, inputs: torch.Tensor) -> None:
        """Take the inputs of the next control step; in place, capturable."""

    @abstractmethod
    def launch(self) -> None:
        """The physics of a control step, from the inputs that were loaded."""

    @abstractmethod
    def flag_diverged(self) -> None:
        """After the physics: mark the instances that have broken; in place, capturable."""

    @abstractmethod
    def memory(self) -> list[torch.Tensor]:
        """Every tensor that `load`, `flag_diverged` and resets read or change in place."""

    @abstractmethod
    def state_dict(self) -> dict[str, torch.Tensor]:
        """Everything needed to go on exactly from here."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from a saved state."""


@dataclass(frozen=True)
class ReplacedState:
    """Tensors that a step replaces by new ones: attributes `names` of `owner`. A captured graph needs them to keep
    their memory, so a capturing collector copies them back after each step."""

    owner: Any
    names: Sequence[str]


class SplitStepEnv(TaskEnv):
    """An env whose control step is `begin_step`, the simulator, `end_step`, and whose rewards can wait.

    `_step` and `_reset` are made of these parts here and nowhere else: whatever collects by the parts collects what a
    plain `env.step` would give. A subclass that wants a step of its own derives from `TaskEnv` (or `EnvBase`) instead;
    overriding `_step` or `_reset` is refused.

    random: generators of what the env draws, one for each candidate, which a `CapturedCollector` prefetches; None, the
    default: it draws nothing, or by means of its own. An env whose steps are captured as graphs draws by these alone.
    """

    random: PopulationRandom | None = None
    _goes_on = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in ("_step", "_reset"):
            if name in vars(cls):
                raise TypeError(
                    f"{cls.__name__} overrides {name}: a collector that steps by parts would pass it by. Override the "
                    "parts (begin_step, simulate, end_step, rewards, start_episodes), or derive from TaskEnv."
                )

    # -------------------------------------------------------------------------------------------- a step in parts

    @abstractmethod
    def begin_step(self, action: torch.Tensor) -> torch.Tensor:
        """A control step up to its physics: actions [P, N, A] -> the simulator's inputs."""

    @abstractmethod
    def simulate(self, inputs: torch.Tensor) -> None:
        """The physics of a control step."""

    @abstractmethod
    def end_step(self, action: torch.Tensor) -> tuple[Any, dict[str, torch.Tensor]]:
        """A control step after its physics, but for its reward.

        Returns what `rewards` wants to know of it, which must stay as it is while later steps are taken, and
        terminated, truncated and done, bool [P, N, 1]. Never waits for a GPU.
        """

    @abstractmethod
    def rewards(self, steps: Sequence[Any]) -> torch.Tensor:
        """Rewards of T steps that `end_step` has ended, [T, P, N]; to the same bits for any T."""

    @abstractmethod
    def observations(self) -> dict[str, torch.Tensor]:
        """What is observed now, name -> [P, N, ...]: of the state that a step ended in, until new episodes are started.
        The tensors are not changed in place by later steps."""

    @abstractmethod
    def channel_values(self) -> dict[str, torch.Tensor]:
        """The channels now, name -> [P, N, ...]; as `observations`."""

    @abstractmethod
    def start_episodes(self, mask: torch.Tensor) -> None:
        """New episodes where mask, bool [P, N]; `observations` is of the new episodes there."""

    # ------------------------------------------------------------------------------------------------- abilities

    def go_on(self, state: TensorDictBase) -> None:
        """`load_full_state`, after which the next reset of all instances starts no episodes."""
        self.load_full_state(state)
        self._goes_on = True

    def groups(self) -> Sequence[SplitStepEnv]:
        """Envs of consecutive candidates that make up this one and may be stepped side by side; itself, the default."""
        return [self]

    def launched_simulator(self) -> LaunchedSimulator | None:
        """The simulator, if its step can stand between captured graphs; None, the default: it cannot."""
        return None

    def replaced_state(self) -> list[ReplacedState]:
        """The state that a step replaces instead of changing it in place."""
        return []

    # --------------------------------------------------------------------------------------------------- TorchRL

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].detach()  # physics gives no gradient
        self.simulate(self.begin_step(action))
        ended, flags = self.end_step(action)
        reward = self.rewards([ended])[0].unsqueeze(-1)
        return self._result({"reward": reward, **flags})

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        if mask is None:
            mask = torch.full(self.batch_size, not self._goes_on, device=self.device)
            self._goes_on = False
        else:
            mask = mask.view(self.batch_size)
        if any_or_tracing(mask):
            self.start_episodes(mask)
        done = torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device)
        return self._result({"done": done, "terminated": done.clone(), "truncated": done.clone()})

    def _result(self, entries: dict[str, Any]) -> TensorDict:
        entries |= self.observations()
        channels = self.channel_values()
        if channels:
            entries["channels"] = TensorDict(channels, batch_size=self.batch_size, device=self.device)
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)
