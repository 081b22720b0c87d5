"""Lagrange multipliers: of a bound on the KL divergence to a reference policy, of a mean that is to be zero, and of a
mean that is to stay below a number."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import torch

from hts.rl.given import OfItsSizes, as_numbers, check_number
from hts.rl.told import tell

LARGEST_EXCESS = 2.0  # of KL / c - 1 in one update: one bad batch must not spend the training on getting back
FAR, LONG = 2.0, 50  # KL / c, updates: alpha has risen by rate * LONG at least, and it has not been enough
LARGEST_PRICE = 5.0  # of a mean that stays too large whatever it costs, per strength
LARGEST_ERROR = (
    10.0  # of m / scale, likewise. Much smaller and the proportional part cannot damp what the integral swings
)


def as_bounds(bounds: float | torch.Tensor) -> torch.Tensor:
    """Bounds of a KL as a tensor, [] or [P]. Raises TypeError for what is no number, ValueError for another mistake."""
    limits = as_numbers("kl_bound", bounds, "a number, or [P] for P candidates")
    if not bool((limits > 0).all()) or limits.numel() == 0:
        raise ValueError(f"kl_bound is {limits.tolist()}; expected positive numbers, infinity for no bound.")
    if limits.ndim > 1:
        raise ValueError(f"kl_bound has the shape {tuple(limits.shape)}; expected a float, or [P] for P candidates.")
    return limits


class LagrangeMultiplier(OfItsSizes):
    """alpha <- [alpha + eta min(KL / c - 1, 2)]_+, once per batch and outside `forward`.

    bounds: c in nats, a float or [P]; infinity switches the bound off. rate: eta. It acts on KL / c, so that tight and
    loose bounds are approached in the same number of batches; alpha starts at 0: nothing pulls until the bound is near.

    A UserWarning, once, tells of a KL above 2 c in 50 calls of `update` one after the other: alpha rises by 2 eta in
    each at most, which large rewards that are not normalised outweigh for long. `step` does not look.

    Buffers value and bounds, both of the shape of bounds. updated: whether `update` or `step` was ever called.
    """

    value: torch.Tensor
    bounds: torch.Tensor
    beyond: torch.Tensor

    def __init__(self, bounds: float | torch.Tensor, rate: float = 0.05) -> None:
        super().__init__()
        limits = as_bounds(bounds)
        check_number("rate", rate, "how far alpha moves in an update")
        if not 0.0 <= rate < math.inf:
            raise ValueError(f"rate is {rate}; expected a number from 0 on, such as 0.05.")
        self.rate, self.updated = rate, False
        self.register_buffer("bounds", limits.clone())
        self.register_buffer("value", torch.zeros_like(limits))
        self.register_buffer("beyond", torch.zeros_like(limits), persistent=False)  # updates with a KL far beyond
        self._told = False

    def forward(self, kl: torch.Tensor) -> torch.Tensor:
        """alpha KL: what the loss adds; nothing where alpha is 0, be KL infinite. Changes nothing."""
        return torch.where(self.value == 0, 0.0, self.value * kl)

    @torch.no_grad()
    def update(self, kl: torch.Tensor) -> torch.Tensor:
        """kl, of the shape of bounds: mean KL over the batch's states with the parameters after its gradient steps.
        Returns the new value. Raises ValueError for another shape, or a NaN, which alpha would keep for good, TypeError
        for what is no number, such as all that the loss returned."""
        if not isinstance(kl, torch.Tensor):
            if not isinstance(kl, Real | list | tuple):
                raise TypeError(
                    f"kl is a {type(kl).__name__}; expected a tensor {tuple(self.bounds.shape)}, as kl_bound is, "
                    "such as loss.kl_to_reference(data)."
                )
            kl = as_numbers("kl", kl, "a number, or [P] for P candidates", self.bounds.device)
        if kl.shape != self.bounds.shape:
            raise ValueError(
                f"kl has the shape {tuple(kl.shape)}, kl_bound {tuple(self.bounds.shape)}; expected the same."
            )
        if bool(kl.isnan().any()):
            raise ValueError(
                f"kl is {kl.tolist()}: the policy, its reference or a state is not finite, as the policy is after a "
                "step on a reward that is NaN. Stop training."
            )
        self._tell_far(kl)
        return self.step(kl)

    def _tell_far(self, kl: torch.Tensor) -> None:
        """Warn, once, of a KL that stays far beyond its bound."""
        if self._told or self.rate == 0.0:
            return
        self.beyond = torch.where(kl > FAR * self.bounds, self.beyond + 1, 0.0)
        if not bool((self.beyond >= LONG).any()):
            return
        self._told = True
        tell(
            f"The KL was above {FAR:g} times its bound in {LONG} updates of the multiplier one after the other: KL / c "
            f"is {(kl / self.bounds).tolist()}, alpha {self.value.tolist()}. Rewards may be so large that alpha, which "
            f"rises by {self.rate * LARGEST_EXCESS:g} an update at most, does not reach what they pay: make the loss "
            "with normalize_advantage=True if it is not, or divide the rewards."
        )

    @torch.no_grad()
    def step(self, kl: torch.Tensor) -> torch.Tensor:
        """`update` without its questions, which wait for a GPU."""
        excess = torch.where(torch.isinf(self.bounds), 0.0, kl / self.bounds - 1.0).clamp(max=LARGEST_EXCESS)
        value = (self.value + self.rate * excess).clamp(min=0.0)
        self.value = value.to(self.value.dtype)  # of a KL in another precision too: a saved state is what goes on
        self.updated = True
        return self.value


class EqualityMultiplier(OfItsSizes):
    """Holds the mean of an error e at zero: nu e is added to the reward, and nu moves against the mean.

    nu = I - gain m / scale with I <- I - rate m / scale once per batch, m the batches' mean error, smoothed: the
    integral finds the price at which nothing is gained by erring, the proportional part damps its swinging (Stooke,
    Achiam and Abbeel 2020, "Responsive Safety in Reinforcement Learning by PID Lagrangian Methods", 2007.03964), and
    the smoothing (of m, with the share `smoothing` of the new batch) keeps one batch's noise out of it. nu has either
    sign. A policy answers a price within ten batches or so, by a speed of change that is limited: gain / rate well
    above that number is what keeps it from swinging.

    scale: an error that matters, in e's unit, so that rate and gain are per such an error; count: P for one multiplier
    per candidate. Buffers value (nu) and integral, reward per second and unit of e, and smoothed, in e's unit, all [P].
    """

    value: torch.Tensor
    integral: torch.Tensor
    smoothed: torch.Tensor

    def __init__(
        self,
        scale: float,
        count: int | None = None,
        *,
        rate: float = 0.05,
        gain: float = 2.0,
        smoothing: float = 0.3,
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        check_number("scale", scale, "an error that matters")
        if not 0.0 < scale < math.inf:
            raise ValueError(f"scale is {scale}; expected a positive number, an error that matters.")
        self.scale, self.rate, self.gain, self.smoothing = scale, rate, gain, smoothing
        shape = () if count is None else (count,)
        self.register_buffer("value", torch.zeros(shape, device=device))
        self.register_buffer("integral", torch.zeros(shape, device=device))
        self.register_buffer("smoothed", torch.zeros(shape, device=device))

    def forward(self, error: torch.Tensor) -> torch.Tensor:
        """nu e, of error's shape; its first dimension is P where there are several. Changes nothing."""
        return self.value.view(*self.value.shape, *(1,) * (error.ndim - self.value.ndim)) * error

    @torch.no_grad()
    def begin(self, price: torch.Tensor) -> None:
        """Begin at a price that was found before, of the shape of `value`."""
        self.integral = price.clone()
        self.value = price.clone()

    @torch.no_grad()
    def update(self, mean: torch.Tensor, strength: float | torch.Tensor = 1.0) -> torch.Tensor:
        """mean: of e over the batch, of the shape of `value`; strength: how strong the rewards are that pull the mean
        away, in reward per second, since a price is found the sooner the larger it has to be. Returns the new value.
        Raises ValueError for a mean of another shape."""
        if mean.shape != self.value.shape:
            raise ValueError(
                f"mean has the shape {tuple(mean.shape)}, expected {tuple(self.value.shape)}: one for each multiplier."
            )
        self.smoothed = self.smoothed + self.smoothing * (mean.to(self.smoothed.dtype) - self.smoothed)
        excess = (self.smoothed / self.scale).clamp(-LARGEST_ERROR, LARGEST_ERROR) * strength
        self.integral = self.integral - self.rate * excess
        self.value = self.integral - self.gain * excess
        return self.value


class UpperMultiplier(EqualityMultiplier):
    """Keeps the mean of x at or below a limit: nu x is added to the reward, and nu is never above 0.

    As `EqualityMultiplier` of the error x - limit, of which a quarter of the limit matters, with nu and its integral
    between -`LARGEST_PRICE` x strength and 0: where the mean is below the limit nothing is paid, and a limit that
    cannot be kept does not drown everything else.

    limit: above 0, in x's unit; others and buffers as of `EqualityMultiplier`.
    """

    def __init__(self, limit: float, count: int | None = None, **how: Any) -> None:
        check_number("limit", limit, "the largest mean that costs nothing")
        if not 0.0 < limit < math.inf:
            raise ValueError(f"limit is {limit}; expected a positive number.")
        super().__init__(limit / 4, count, **how)
        self.limit = limit

    @torch.no_grad()
    def update(self, mean: torch.Tensor, strength: float | torch.Tensor = 1.0) -> torch.Tensor:
        """As of `EqualityMultiplier`; mean: of x."""
        super().update(mean - self.limit, strength)
        least = -LARGEST_PRICE * torch.as_tensor(strength, device=self.value.device).expand_as(self.value)
        self.integral = self.integral.clamp(max=0.0).maximum(least)
        self.value = self.value.clamp(max=0.0).maximum(least)
        return self.value
