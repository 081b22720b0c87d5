"""The last word on the bound, when training is over: a policy that ended beyond it is drawn back inside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from hts_rsl_rl.errors import AnchorError
from hts_rsl_rl.ppo import AnchoredPPO

if TYPE_CHECKING:
    from rsl_rl.runners import OnPolicyRunner

SLACK = 1.05  # of c, on a fresh batch; beyond it the policy is drawn back
MOST_ROUNDS = 8
BISECTIONS = 12


def finish(runner: OnPolicyRunner) -> float:
    """Measure the KL on a fresh batch of the policy's own states; beyond 1.05 c, project. Returns the last KL, nats.

    Call it after `runner.learn` and before the last `runner.save`. The multiplier holds the mean over batches; a single
    last batch may end a little beyond. As a projected policy visits other states, it is measured anew each time. The
    env is stepped; nothing is learned.
    """
    algorithm = runner.alg
    if not isinstance(algorithm, AnchoredPPO):
        raise AnchorError(f"finish() takes a runner of AnchoredPPO, this one has {type(algorithm).__name__}.")
    bound = algorithm.lagrange.bound
    for _ in range(MOST_ROUNDS):
        states = fresh_states(runner)
        kl, _ = algorithm.kl_to_anchor(states)
        if not math.isfinite(kl):
            raise AnchorError(
                f"The KL to the anchor is {kl}: the policy is not finite. Go back to an earlier checkpoint."
            )
        if kl <= SLACK * bound:
            return kl
        project(algorithm, states)
    raise AnchorError(
        f"After {MOST_ROUNDS} projections the KL to the anchor is {kl:.3g} nats, bound {bound:.3g}: the states change "
        "with every step back. Train on with a smaller learning rate, and finish again."
    )


@torch.inference_mode()
def fresh_states(runner: OnPolicyRunner) -> TensorDict:
    """Observations of one batch under the exploring policy as it is now, [S]; normalisers stand still."""
    algorithm, found = runner.alg, []
    observations = runner.env.get_observations().to(runner.device)
    for _ in range(runner.cfg["num_steps_per_env"]):
        found.append(observations.clone())
        actions = algorithm.actor(observations, stochastic_output=True)
        observations = runner.env.step(actions.to(runner.env.device))[0].to(runner.device)
    return torch.cat(found)


@torch.no_grad()
def project(algorithm: AnchoredPPO, states: TensorDict) -> float:
    """theta <- anchor + s (theta - anchor), the largest s in [0, 1] with KL <= c on these states, by bisection;
    returns s."""
    policy = algorithm.get_policy()
    parameters, anchors = dict(policy.named_parameters()), dict(algorithm.anchor.named_parameters())
    ends = {name: value.clone() for name, value in parameters.items()}

    def beyond(scale: float) -> bool:
        for name, value in parameters.items():
            value.copy_(ends[name] if scale == 1.0 else anchors[name] + scale * (ends[name] - anchors[name]))
        return algorithm.kl_to_anchor(states)[0] > algorithm.lagrange.bound

    if not beyond(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if beyond(middle) else (middle, high)
    beyond(low)
    return low
