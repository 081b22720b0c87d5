"""The analytic stand-in of an objective, asked: what comes back is one number per sample, or one line says whose
mistake it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from hts.errors import PluginError
from hts.guarded import guarded

if TYPE_CHECKING:
    from torch import Tensor

    from hts.channels import Channel
    from hts.contracts import Objective
    from hts.recordings.recording import Recording

BATCHES = ((128,), (2, 3))
"""Along a recording, and in a training env: what a proxy is tried with before anything is spent."""


def proxy_of(objective: Objective, channels: Mapping[str, Tensor], batch: Sequence[int]) -> Tensor | None:
    """The stand-in, of shape batch; None if the objective has none. Its numbers are not looked at: on a GPU that would
    wait for them.

    channels: the objective's inputs, (*batch, *shape of the channel) each. Raises PluginError for an exception in
    `proxy`, a channel that is no input, another shape or no tensor.
    """
    what = f"Objective '{objective.name}': proxy()"

    def ask() -> Tensor | None:
        try:
            return objective.proxy(dict(channels))
        except KeyError as error:
            if not error.args or error.args[0] in channels:
                raise
            raise PluginError(
                f"{what} reads '{error.args[0]}', which is none of its inputs ({', '.join(channels)}). Name it in "
                "`inputs`, or do without it."
            ) from error

    found = guarded(what, ask)
    if found is None:
        return None
    if not isinstance(found, torch.Tensor):
        raise PluginError(
            f"{what} gave {type(found).__name__}, expected a torch.Tensor with one number for each sample, or None."
        )
    if tuple(found.shape) not in (tuple(batch), (*batch, 1)):
        given = ", ".join(f"{name} {tuple(one.shape)}" for name, one in channels.items())
        raise PluginError(
            f"{what} gave shape {tuple(found.shape)} for {given}; expected {tuple(batch)}, one number for each sample: "
            "sum over joints with .sum(-1)."
        )
    return found


def proxy_series(
    objective: Objective, channels: Mapping[str, np.ndarray], where: str, some: bool = False
) -> np.ndarray | None:
    """The stand-in along channels (T, ...), (T,) float64; None if the objective has none. Raises PluginError, for
    numbers that are not finite too; some: only if none is. where: whose channels they are."""
    asked = {name: torch.from_numpy(np.array(channels[name])) for name in objective.inputs}
    found = proxy_of(objective, asked, (len(next(iter(asked.values()))),))
    if found is None:
        return None
    values: np.ndarray = found.detach().reshape(-1).double().numpy()
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad) and (not some or len(bad) == len(values)):
        raise PluginError(
            f"Objective '{objective.name}': proxy() is {values[bad[0]]:g} at sample {bad[0]} of {len(values)} of "
            f"{where}; expected finite numbers. Look for a division, a root or a logarithm in it."
        )
    return values


def proxy_along(objective: Objective, recording: Recording) -> np.ndarray | None:
    """The stand-in at each sample of a recording, (T,); None if the objective has none. Raises PluginError."""
    channels = {name: recording.values(name) for name in objective.inputs}
    return proxy_series(objective, channels, f"recording {recording.id}")


def has_proxy(objective: Objective, inputs: Sequence[Channel]) -> bool:
    """Whether the objective has a stand-in. Raises PluginError as `proxy_of`."""
    return proxy_of(objective, {one.name: torch.zeros(1, *one.shape) for one in inputs}, (1,)) is not None


def try_proxy(objective: Objective, inputs: Sequence[Channel]) -> bool:
    """Whether there is one: ask for it with made-up inputs, between -0.5 and 1.5 in their units. Raises PluginError for
    what a run or a fit would end in. Of the numbers one that is finite is enough: an angle of a unit vector has none
    for most of them."""
    rng = np.random.default_rng(0)
    known = False
    for batch in BATCHES:
        made_up = {one.name: rng.uniform(-0.5, 1.5, (*batch, *one.shape)).astype(np.float32) for one in inputs}
        if len(batch) == 1:
            proxy_series(objective, made_up, "made-up channels between -0.5 and 1.5", some=True)
        else:
            asked = {name: torch.from_numpy(one) for name, one in made_up.items()}
            known = proxy_of(objective, asked, batch) is not None or known
    return known
