"""The reward and the proxy of an objective: functions of tensors over candidates and worlds, [P, N]."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hts.errors import PluginError
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure
from hts.testing.checks.made_up import sim_channels

CANDIDATES, PER_CANDIDATE = 3, 4

FAR = 20.0  # standard deviations to which a reward is followed
FEW = 10  # steps of 0.05 standard deviations: a reward that changes in fewer is a threshold
SUDDEN = 0.5  # of the steepest step: a clip ends with more, what saturates smoothly with next to nothing

Tensors = dict[str, Any]  # name -> torch.Tensor [P, N, …]; torch is imported when something is checked
Function = Callable[[Tensors], Any]


def _reward(entry: Entry, registry: Registry) -> tuple[Function, Tensors]:
    """reward as a function of named tensors, and predictions from -3 to 3 standard deviations."""
    import torch

    prediction = torch.linspace(-3.0, 3.0, CANDIDATES * PER_CANDIDATE).reshape(CANDIDATES, PER_CANDIDATE)
    objective = entry.factory({})
    return (lambda given: objective.reward(given["prediction"])), {"prediction": prediction}


def _proxy(entry: Entry, registry: Registry) -> tuple[Function, Tensors] | None:
    """The same for proxy and random sim channels; None if there is no proxy."""
    import torch

    objective, known = entry.factory({}), sim_channels(registry)
    generator = torch.Generator().manual_seed(0)
    shape = (CANDIDATES, PER_CANDIDATE)
    channels = {
        name: torch.rand(*shape, *known[name].shape, generator=generator) for name in objective.inputs if name in known
    }
    return None if objective.proxy(dict(channels)) is None else (objective.proxy, channels)


def _both(entry: Entry, registry: Registry) -> list[tuple[str, Function, Tensors]]:
    proxy = _proxy(entry, registry)
    return [("reward", *_reward(entry, registry)), *([("proxy", *proxy)] if proxy else [])]


def gives_one_number_per_world(entry: Entry, registry: Registry) -> None:
    """reward (and proxy) give one finite number per candidate and world, not the same for all, again and again."""
    import torch

    for what, function, given in _both(entry, registry):
        found = function(_copy(given))
        wanted = (CANDIDATES, PER_CANDIDATE)
        ensure(isinstance(found, torch.Tensor), f"{what} gives a {type(found).__name__}, not a torch.Tensor")
        ensure(
            tuple(found.shape) == wanted,
            f"{what} has shape {tuple(found.shape)} for [P, N] = {wanted}: it gives one number per sample, in the "
            "shape of what it is given",
        )
        ensure(bool(torch.isfinite(found).all()), f"{what} gives NaN or infinity for ordinary numbers")
        ensure(float(found.std()) > 0, f"{what} is the same number whatever it is given")
        ensure(bool(torch.equal(found, function(_copy(given)))), f"{what} differs from one time to the next")


def does_not_depend_on_neighbours(entry: Entry, registry: Registry) -> None:
    """A candidate's reward (and proxy) is the same alone and in a crowd: nothing is averaged over candidates."""
    import torch

    for what, function, given in _both(entry, registry):
        crowd = function(_copy(given))
        for index in range(CANDIDATES):
            alone = function({name: value[index : index + 1].clone() for name, value in given.items()})
            equal = alone.shape == crowd[index : index + 1].shape and torch.allclose(
                alone, crowd[index : index + 1], rtol=1e-5, atol=1e-6
            )
            ensure(equal, f"{what} of candidate {index} depends on the candidates beside it")
        world = function({name: value[:1, :1].clone() for name, value in given.items()})
        equal = torch.allclose(world, crowd[:1, :1], rtol=1e-5, atol=1e-6)
        ensure(equal, f"{what} of a world depends on the worlds beside it")


def lets_nan_through(entry: Entry, registry: Registry) -> None:
    """A NaN stays NaN in reward (and proxy), in its own world alone: a number could be the best reward there is."""
    import torch

    for what, function, given in _both(entry, registry):
        clean = function(_copy(given))
        dirty = _copy(given)
        for value in dirty.values():
            value[1, 2] = torch.nan
        found = function(dirty)
        ensure(not bool(torch.isfinite(found[1, 2])), f"{what} makes {float(found[1, 2]):g} of a NaN")
        found[1, 2] = clean[1, 2]
        ensure(bool(torch.allclose(found, clean, rtol=1e-5, atol=1e-6)), f"a NaN in one world changes {what} of others")


def clips_nothing(entry: Entry, registry: Registry) -> None:
    """reward is not clipped at both ends: beyond a bound it would say nothing of better and worse. It may saturate
    smoothly, and it may stay the same on one side."""
    import torch

    objective = entry.factory({})
    prediction = torch.linspace(-FAR, FAR, 801)
    reward = objective.reward(prediction[:, None])[:, 0].double()
    steps = (reward[1:] - reward[:-1]).abs()
    moving = steps.nonzero()[:, 0]
    if len(moving) < FEW or len(moving) == len(steps) or reward[0] == reward[-1]:
        return  # a threshold, nothing flat, or a reward of being near a value
    first, last = int(moving[0]), int(moving[-1])
    at_once = min(float(steps[first + 1]), float(steps[last - 1])) > SUDDEN * float(steps.max())
    ensure(
        not (first > 0 and last < len(steps) - 1 and at_once),
        f"reward is the same for all predictions below {prediction[first]:.2g} and above {prediction[last + 1]:.2g} "
        "standard deviations: leave clamp out",
    )


def changes_nothing(entry: Entry, registry: Registry) -> None:
    """reward (and proxy) only read the tensors that they are given: the env goes on with them."""
    import torch

    for what, function, given in _both(entry, registry):
        handed = _copy(given)
        function(handed)
        changed = [name for name, value in given.items() if name not in handed or not torch.equal(value, handed[name])]
        ensure(not changed, f"{what} changes '{', '.join(changed)}' in place")


def stays_on_its_device(entry: Entry, registry: Registry) -> None:
    """reward (and proxy) stay on the device and in the precision of what they are given: training may be on a GPU."""
    import torch

    device = torch.device("cuda" if torch.cuda.is_available() else "meta")
    for what, function, given in _both(entry, registry):
        found = function(_copy(given))
        ensure(found.dtype == torch.float32, f"{what} of float32 is {str(found.dtype).removeprefix('torch.')}")
        try:
            elsewhere = function({name: value.to(device) for name, value in given.items()})
        except (RuntimeError, TypeError, NotImplementedError) as error:
            # "meta" has shapes and no numbers: what only asks for a number there is no fault,
            # what leaves the device is.
            text = str(error)
            if device.type == "cuda" or any(phrase in text for phrase in ("device", "numpy", "copy out of meta")):
                raise PluginError(
                    f"{what} leaves the device of its tensors ({' '.join(text.split())[:100]})"
                ) from error
            continue
        ensure(elsewhere.device.type == device.type, f"{what} gives a tensor on another device, {elsewhere.device}")


def proxy_has_weights(entry: Entry, registry: Registry) -> None:
    """With a proxy come baseline_weights, the λ that `hts baseline` sweeps."""
    if _proxy(entry, registry) is not None:
        ensure(bool(entry.factory({}).baseline_weights), "has a proxy and no baseline_weights")


def _copy(given: Tensors) -> Tensors:
    return {name: value.clone() for name, value in given.items()}


CHECKS = (
    gives_one_number_per_world,
    does_not_depend_on_neighbours,
    lets_nan_through,
    clips_nothing,
    changes_nothing,
    stays_on_its_device,
    proxy_has_weights,
)
