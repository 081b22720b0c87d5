"""The last word on the bound for an actor of TorchRL's own; of populations `kl_bound` has it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.modules import set_recurrent_mode

from hts.rl.actor import PopulationActor
from hts.rl.counted import counted
from hts.rl.given import check_number
from hts.rl.kl import distribution_kl
from hts.rl.loss_checks import check_actor, check_not_empty, distribution_of


@torch.no_grad()
@set_recurrent_mode(True)  # as TorchRL has it in a loss
def project_actor_to_kl_bound(
    actor: TensorDictModuleBase,
    reference: TensorDictModuleBase,
    tensordict: TensorDictBase,
    bound: float,
    steps: int = 12,
) -> float:
    """Where the mean KL(actor || reference) over a batch's states is above bound, shrink the actor's parameters towards
    the reference's, in place: reference + s (actor - reference), the largest s in [0, 1] within it, by bisection.
    Returns s.

    actor: one policy, as `KLConstrainedPPOLoss` takes it; reference: what it was, with the same parameters by name, as
    the loss's `reference` is; tensordict: what both read, of any shape; a recurrent actor's are whole stretches,
    [..., T]; steps that TorchRL's masks leave out do not count; bound: c, nats. Where the KL is of one sampled action,
    the bound holds as closely as that mean is known: give many states. Draws no random numbers of the caller's.

    Raises TypeError for a population (`project_to_kl_bound` takes it); ValueError, with the actor as it was given, for
    a bound that is not above 0, an empty batch, a reference with other parameters, a KL that is NaN, and one that is
    above the bound with the reference's parameters too: then something else of the two differs, such as a normaliser.
    """
    check_actor(actor)
    check_actor(reference, "reference")
    check_number("bound", bound, "the largest mean KL, nats")
    check_not_empty(tensordict.shape)
    if any(isinstance(module, PopulationActor) for module in actor.modules()):
        raise TypeError("actor is of a population; project_to_kl_bound(population, ...) shrinks its candidates.")
    if not bound > 0:
        raise ValueError(f"bound is {bound}; expected a positive number, infinity for no bound.")
    ends = {name: parameter.clone() for name, parameter in actor.named_parameters()}
    starts = {**dict(reference.named_parameters()), **dict(reference.named_buffers())}  # the loss keeps it in buffers
    other = [name for name, end in ends.items() if name not in starts or starts[name].shape != end.shape]
    if other:
        raise ValueError(
            f"reference has no {other[0]!r} of the actor's shape; expected what the actor was, a copy of it."
        )
    devices = {end.device for end in ends.values() if end.device.type == "cuda"}

    def place(scale: float) -> float:
        for name, parameter in actor.named_parameters():
            start, end = starts[name], ends[name]
            parameter.copy_(end if scale == 1.0 else start + scale * (end - start))
        with torch.random.fork_rng(devices):  # the same draws each time, where one action stands for a KL
            policy = distribution_of("actor", actor, tensordict.copy())
            kl = distribution_kl(policy, distribution_of("reference", reference, tensordict.copy()))
        steps = counted(tensordict, kl.shape)
        return float(kl.mean() if steps is None else kl[steps].mean())

    with _evaluating(actor, reference):
        kl, low, high = place(1.0), 0.0, 1.0
        if kl <= bound:
            return 1.0
        least = place(0.0)
        if math.isnan(kl) or not least <= bound:
            place(1.0)
            raise ValueError(
                f"The KL is {kl:g}, and {least:g} with the reference's parameters; expected at most {bound:g} then. A "
                "weight or a state is not finite, or the two differ in more than parameters, such as a normaliser."
            )
        for _ in range(steps):
            middle = (low + high) / 2
            low, high = (middle, high) if place(middle) <= bound else (low, middle)
        place(low)
        return low


@contextmanager
def _evaluating(*networks: TensorDictModuleBase) -> Iterator[None]:
    """In `eval` mode, so that no dropout is drawn and no running mean moves; then each module as it was."""
    modes = [(module, module.training) for network in networks for module in network.modules()]
    for network in networks:
        network.eval()
    try:
        yield
    finally:
        for module, training in modes:
            module.training = training
