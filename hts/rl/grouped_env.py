"""Envs of a few candidates each, as one env of all of them: a collector may step the groups side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from hts.errors import SimulationError
from hts.rl.random import PopulationRandom
from hts.rl.task_env import SplitStepEnv


class GroupedEnv(SplitStepEnv):
    """One env of P candidates out of envs of consecutive candidates, which share nothing that they change.

    Stepped as a whole it steps one group after the other, to the bit as one env of all candidates does. A collector
    that gives each group a thread keeps the cores busy: one group is in its physics while another decides, as in the
    double-buffered sampling of Petrenko et al. 2020 (Sample Factory).
    """

    batch_locked = True

    def __init__(self, groups: Sequence[SplitStepEnv]) -> None:
        first, count = groups[0], sum(group.batch_size[0] for group in groups)
        super().__init__(device=first.device, batch_size=torch.Size((count, *first.batch_size[1:])))
        self._groups = tuple(groups)
        self._sizes = [group.batch_size[0] for group in groups]
        self.dt, self.observation_layout = first.dt, first.observation_layout
        randoms = [group.random for group in groups if group.random is not None]
        if randoms and len(randoms) < len(groups):
            raise ValueError(
                f"{len(randoms)} of {len(groups)} groups have generators of their own (random); expected all, or none."
            )
        self.random = PopulationRandom.joined(randoms) if randoms else None
        for name in ("observation_spec", "action_spec", "reward_spec", "done_spec"):
            spec = getattr(first, f"full_{name}" if name == "done_spec" else name)
            setattr(self, name, spec[0].expand(count, *spec.shape[1:]))

    def groups(self) -> Sequence[SplitStepEnv]:
        return self._groups

    # -------------------------------------------------------------------------------------------- a step in parts

    def begin_step(self, action: torch.Tensor) -> Any:
        """A control step up to its physics: actions [P, N, A] -> each group's inputs."""
        return [group.begin_step(part) for group, part in self._parts(action)]

    def simulate(self, inputs: Any) -> None:
        """The physics of a control step."""
        for group, part in zip(self._groups, inputs, strict=True):
            group.simulate(part)

    def end_step(self, action: torch.Tensor) -> tuple[Any, dict[str, torch.Tensor]]:
        """What each group's reward wants to know, and the flags of all."""
        seen, flags = zip(*(group.end_step(part) for group, part in self._parts(action)), strict=True)
        return seen, _joined(flags)

    def rewards(self, steps: Sequence[Any]) -> torch.Tensor:
        """Rewards of T steps, [T, P, N]."""
        each = zip(self._groups, zip(*steps, strict=True), strict=True)
        return torch.cat([group.rewards(seen) for group, seen in each], 1)

    def observations(self) -> dict[str, torch.Tensor]:
        """What is observed now, name -> [P, N, ...]."""
        return _joined([group.observations() for group in self._groups])

    def channel_values(self) -> dict[str, torch.Tensor]:
        """The channels now, name -> [P, N, ...]."""
        return _joined([group.channel_values() for group in self._groups])

    def start_episodes(self, mask: torch.Tensor) -> None:
        """New episodes where mask, bool [P, N]."""
        for group, part in self._parts(mask):
            if bool(part.any()):
                group.start_episodes(part)

    # ------------------------------------------------------------------------------------------------- the whole

    def full_state(self) -> TensorDict | None:
        """Everything needed to go on from here: what one env of all candidates would give. In the state of a group
        every tensor begins with its candidates or their instances, or is one number that all groups share (a clock).
        Raises SimulationError where such a number is not the same in all of them."""
        first, *others = [group.full_state() for group in self._groups]
        return None if first is None else first.named_apply(self._whole, *others, nested_keys=True)

    def load_full_state(self, state: TensorDictBase) -> None:
        """Go on from `full_state`."""
        for index, group in enumerate(self._groups):
            group.load_full_state(
                state.apply(lambda whole, index=index: self._split(whole)[index] if whole.ndim else whole.clone())
            )

    def check(self) -> None:
        """Raise SimulationError if something went wrong in a group's simulator."""
        for group in self._groups:
            group.check()

    def close(self, **kwargs: Any) -> None:
        for group in self._groups:
            group.close()
        super().close(**kwargs)

    def _set_seed(self, seed: int | None) -> None:
        """Candidate p draws from seed + p, in whichever group."""
        begin = 0
        for group, size in zip(self._groups, self._sizes, strict=True):
            group.set_seed(None if seed is None else seed + begin)
            begin += size

    def _parts(self, whole: torch.Tensor) -> list[tuple[SplitStepEnv, torch.Tensor]]:
        """Each group with its rows of a tensor [P, ...]."""
        return list(zip(self._groups, self._split(whole), strict=True))

    def _whole(self, name: str | tuple[str, ...], *parts: torch.Tensor) -> torch.Tensor:
        """One tensor out of what each group saves under a name."""
        if parts[0].ndim:
            return torch.cat(parts)
        if not all(torch.equal(part, parts[0]) for part in parts):
            path = name if isinstance(name, str) else ".".join(name)
            raise SimulationError(
                f"{type(self._groups[0]).__name__} saves one number as '{path}', and its groups have different ones "
                f"({', '.join(str(part.item()) for part in parts)}). Save one for each candidate, [P], in full_state()."
            )
        return parts[0]

    def _split(self, whole: torch.Tensor) -> Sequence[torch.Tensor]:
        """Each group's rows of a tensor that begins with candidates [P, ...] or with their instances [P·N, ...]."""
        each = len(whole) // self.batch_size[0]
        return whole.split([size * each for size in self._sizes])


def _joined(parts: Sequence[Mapping[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Name -> [P, N, ...] out of what each group gives under that name."""
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
