"""`finish`: a policy that ended beyond the bound is drawn back; one that did not stays as it is."""

from __future__ import annotations

import pytest
import torch


def test_a_policy_beyond_its_bound_is_drawn_back_and_one_inside_is_left_alone(tmp_path):
    from slope import anchor_file, anchored

    from hts_rsl_rl import finish

    runner = anchored(anchor_file(tmp_path), 0.1)
    before = {name: value.clone() for name, value in runner.alg.actor.state_dict().items()}
    assert finish(runner) == pytest.approx(0.0, abs=1e-6)
    assert all(torch.equal(value, before[name]) for name, value in runner.alg.actor.state_dict().items())

    with torch.no_grad():
        runner.alg.actor.mlp[-1].bias += 1.0  # |d|² / 2σ² = 2 · 1 / 0.5 = 4 nats; half the way costs a quarter
    kl = finish(runner)
    assert 0.095 < kl <= 1.05 * 0.1
    moved = runner.alg.actor.mlp[-1].bias - before["mlp.4.bias" if "mlp.4.bias" in before else "mlp.2.bias"]
    assert moved.tolist() == pytest.approx([(0.1 / 4.0) ** 0.5] * 2, rel=0.02)


def test_finish_wants_a_runner_of_anchored_ppo():
    from rsl_rl.runners import OnPolicyRunner
    from slope import Slope, config

    from hts_rsl_rl import AnchorError, finish

    with pytest.raises(AnchorError, match="this one has PPO"):
        finish(OnPolicyRunner(Slope(), config(), device="cpu"))
