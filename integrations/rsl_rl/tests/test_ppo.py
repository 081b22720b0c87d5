"""`AnchoredPPO`: its mathematics, what it refuses, and what a checkpoint keeps."""

from __future__ import annotations

import copy
import math

import pytest
import torch


@pytest.fixture
def path(tmp_path):
    from slope import anchor_file

    return anchor_file(tmp_path)


def refused(path, **algorithm) -> str:
    from slope import anchored

    from hts_rsl_rl import AnchorError

    with pytest.raises(AnchorError) as error:
        anchored(path, algorithm.pop("kl_bound", 0.5), **algorithm)
    assert "\n" not in str(error.value)
    return str(error.value)


def same(one, other) -> bool:
    return all(torch.equal(value, other[name]) for name, value in one.items())


def test_a_policy_begins_as_its_anchor_with_no_kl_to_it(path):
    from slope import Slope, anchored

    runner = anchored(path, 0.5)
    kl, widened = runner.alg.kl_to_anchor(Slope().get_observations())
    assert abs(kl) < 1e-7 and abs(widened - 1.0) < 1e-6
    saved = torch.load(path, weights_only=True)
    assert same(saved["actor_state_dict"], runner.alg.get_policy().state_dict())
    assert same(saved["critic_state_dict"], runner.alg.critic.state_dict())


def test_the_kl_is_that_of_the_policy_first_by_the_formula_of_diagonal_gaussians(path):
    """A shift of d and σ twice as wide: sum over two actions of ln(1/2) + (4 σ² + d²) / 2σ² - 1/2."""
    from slope import SIGMA, Slope, anchored

    algorithm = anchored(path, 0.5).alg
    with torch.no_grad():
        algorithm.actor.mlp[-1].bias += torch.tensor([0.1, -0.3])
        algorithm.actor.distribution.log_std_param += math.log(2.0)
    expected = sum(math.log(0.5) + (4 * SIGMA**2 + d**2) / (2 * SIGMA**2) - 0.5 for d in (0.1, -0.3))
    kl, widened = algorithm.kl_to_anchor(Slope().get_observations())
    assert kl == pytest.approx(expected, rel=1e-5) and widened == pytest.approx(2.0)


def test_without_a_bound_it_is_the_ppo_of_rsl_rl(path):
    from rsl_rl.runners import OnPolicyRunner
    from slope import Slope, anchored, config

    ours = anchored(path, math.inf)
    torch.manual_seed(1)
    theirs = OnPolicyRunner(Slope(), config(), device="cpu")
    theirs.load(path, load_cfg={"actor": True, "critic": True})
    for runner in (ours, theirs):
        torch.manual_seed(2)
        runner.learn(1)
        first = {name: value.clone() for name, value in runner.alg.actor.state_dict().items()}
        assert not same(first, torch.load(path, weights_only=True)["actor_state_dict"])
    # Ours measures a KL after the batch, which draws random numbers, so the first batch alone can be compared.
    for one, other in ((ours.alg.actor, theirs.alg.actor), (ours.alg.critic, theirs.alg.critic)):
        for name, value in one.state_dict().items():
            torch.testing.assert_close(value, other.state_dict()[name], atol=1e-6, rtol=1e-5)


def test_the_anchor_never_moves_and_no_optimiser_knows_it(path):
    from slope import anchored

    runner = anchored(path, 0.2)
    before = copy.deepcopy(runner.alg.anchor.state_dict())
    runner.learn(2)
    assert same(before, runner.alg.anchor.state_dict())
    known = {id(value) for group in runner.alg.optimizer.param_groups for value in group["params"]}
    assert not known & {id(value) for value in runner.alg.anchor.parameters()}


def test_the_multiplier_grows_beyond_the_bound_falls_below_it_and_is_never_negative():
    from hts_rsl_rl.multiplier import LagrangeMultiplier

    multiplier = LagrangeMultiplier(0.5, rate=0.1)
    assert multiplier.update(0.25) == 0.0
    assert multiplier.update(1.0) == pytest.approx(0.1)  # KL / c - 1 = 1
    assert multiplier.update(50.0) == pytest.approx(0.3)  # at most 2
    assert multiplier.update(0.25) == pytest.approx(0.25)
    assert LagrangeMultiplier(math.inf).update(50.0) == 0.0


def test_a_number_that_is_none_stops_the_training_before_a_step_is_made_of_it(path):
    from slope import anchored

    from hts_rsl_rl import AnchorError

    runner = anchored(path, 0.2)
    before = copy.deepcopy(runner.alg.actor.state_dict())
    runner.cfg["check_for_nan"] = False  # rsl_rl's own look at the rewards, which can be switched off
    runner.env.level = math.nan
    with pytest.raises(AnchorError, match="The loss is not finite: surrogate nan"):
        runner.learn(1)
    assert same(before, runner.alg.actor.state_dict())
    with pytest.raises(AnchorError, match="KL to the anchor is nan"):
        runner.alg.lagrange.update(math.nan)


def test_centring_takes_a_level_out_of_the_rewards(path):
    """A thousand more in every reward is a thousand in the centre and nothing in what is learned from."""
    from slope import Slope, anchored

    runner = anchored(path, 0.2, level=1000.0, centring_rate=0.05)
    seen = []
    runner.alg.update = lambda: (seen.append(runner.alg.storage.rewards.clone()), runner.alg.storage.clear(), {})[2]
    runner.learn(1)
    assert abs(seen[0].mean()) < 1e-3 and 0.1 < seen[0].std() < 10.0
    assert float(runner.alg.centring.mean) == pytest.approx(1000.0, abs=5.0)
    assert isinstance(runner.env, Slope)


def test_kl_and_multiplier_are_logged_with_the_losses(path, tmp_path):
    from slope import Slope, anchored
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    runner = anchored(path, 0.2, centring_rate=0.1)
    runner.logger.log_dir = str(tmp_path / "log")
    runner.learn(2)
    found = EventAccumulator(str(tmp_path / "log")).Reload()
    for name in ("kl_to_anchor", "multiplier", "sigma_over_anchor", "reward_centre"):
        assert len(found.Scalars(f"Loss/{name}")) == 2
    assert found.Scalars("Loss/kl_to_anchor")[-1].value > 0
    assert isinstance(runner.env, Slope)


def test_a_killed_run_goes_on_with_its_multiplier_and_another_anchor_begins_anew(path, tmp_path):
    from slope import Slope, anchored

    first = anchored(path, 0.01, centring_rate=0.1)
    first.learn(3)
    assert first.alg.lagrange.value > 0
    first.save(str(tmp_path / "model_3.pt"))
    torch.load(tmp_path / "model_3.pt", weights_only=True)  # numbers and texts alone

    again = anchored(path, 0.01, centring_rate=0.1)
    again.load(str(tmp_path / "model_3.pt"))
    assert again.alg.lagrange.value == first.alg.lagrange.value
    assert float(again.alg.centring.mean) == pytest.approx(float(first.alg.centring.mean))
    states = Slope(seed=5).get_observations()
    assert again.alg.kl_to_anchor(states)[0] == pytest.approx(first.alg.kl_to_anchor(states)[0])

    other = anchored(str(tmp_path / "model_3.pt"), 0.01)
    other.load(str(tmp_path / "model_3.pt"))
    assert other.alg.lagrange.value == 0.0 and other.alg.anchor_sha256 != first.alg.anchor_sha256


def test_what_was_trained_leaves_as_any_policy_of_rsl_rl_with_the_same_actions(path, tmp_path):
    """Into a runner of plain PPO, TorchScript and ONNX; the largest difference of an action is below 1e-5."""
    from onnx.reference import ReferenceEvaluator
    from rsl_rl.runners import OnPolicyRunner
    from slope import Slope, anchored, config

    runner = anchored(path, 0.2)
    runner.learn(2)
    runner.save(str(tmp_path / "model_2.pt"))
    plain = OnPolicyRunner(Slope(), config(), device="cpu")
    plain.load(str(tmp_path / "model_2.pt"))
    seen = Slope(seed=3).get_observations()
    with torch.no_grad():
        actions = runner.alg.get_policy()(seen)
        assert torch.equal(plain.alg.get_policy()(seen), actions)
        runner.export_policy_to_jit(str(tmp_path))
        scripted = torch.jit.load(tmp_path / "policy.pt")(seen["policy"])
    assert (scripted - actions).abs().max() < 1e-5
    runner.export_policy_to_onnx(str(tmp_path))
    network = ReferenceEvaluator(str(tmp_path / "policy.onnx"))
    for observation, action in zip(seen["policy"][:8], actions, strict=False):
        (found,) = network.run(None, {"obs": observation[None].numpy()})
        assert abs(found[0] - action.numpy()).max() < 1e-5


def test_the_normaliser_stands_still_unless_it_is_let_go(path):
    from rsl_rl.runners import OnPolicyRunner
    from slope import Slope, config

    def normalised(**algorithm):
        settings = config(**algorithm)
        for model in ("actor", "critic"):
            settings[model]["obs_normalization"] = True
        return OnPolicyRunner(Slope(), settings, device="cpu")

    plain = normalised()
    plain.learn(1)
    saved = path.replace("model_0", "model_1")
    plain.save(saved)
    ours = {"class_name": "hts_rsl_rl:AnchoredPPO", "anchor_checkpoint": saved, "kl_bound": 0.2}
    mean, seen = plain.alg.actor.obs_normalizer.mean, plain.alg.actor.obs_normalizer.count
    for freeze in (True, False):
        runner = normalised(**ours, freeze_normalization=freeze)
        runner.env.random.manual_seed(1)  # other states than those that it has learned from
        runner.learn(1)
        assert torch.equal(runner.alg.actor.obs_normalizer.mean, mean) is freeze
        assert torch.equal(runner.alg.anchor.obs_normalizer.mean, mean)
        assert runner.alg.actor.obs_normalizer.count == (seen if freeze else 2 * seen)
        assert runner.alg.critic.obs_normalizer.count == 2 * seen


# --------------------------------------------------------------------------------------------------- files


def test_a_checkpoint_of_earlier_versions_is_the_same_anchor(path):
    from slope import anchored

    new = torch.load(path, weights_only=True)
    actor, old = new["actor_state_dict"], {}
    for name, value in actor.items():
        old["log_std" if name.startswith("distribution.") else name.replace("mlp.", "actor.")] = value
    old |= {name.replace("mlp.", "critic."): value for name, value in new["critic_state_dict"].items()}
    earlier = path.replace("model_0", "model_old")
    torch.save({"model_state_dict": old, "iter": 5, "infos": None}, earlier)
    assert anchored(earlier, 0.5).alg.anchor_sha256 == anchored(path, 0.5).alg.anchor_sha256


def test_what_cannot_be_an_anchor_is_refused_in_a_line(path, tmp_path):
    saved = torch.load(path, weights_only=True)
    assert "is no file" in refused(str(tmp_path / "missing.pt"))
    assert "anchor_checkpoint is ''; expected a file" in refused("")
    assert "anchor_checkpoint is None; expected a file" in refused(None)

    def written(**changes) -> str:
        torch.save({**saved, **changes}, tmp_path / "bad.pt")
        return str(tmp_path / "bad.pt")

    actor = dict(saved["actor_state_dict"])
    assert "'mlp.0.weight' has shape (32, 4)" in refused(
        written(actor_state_dict={**actor, "mlp.0.weight": torch.zeros(32, 4)})
    )
    assert "lacks 'mlp.0.bias'" in refused(
        written(actor_state_dict={name: value for name, value in actor.items() if name != "mlp.0.bias"})
    )
    assert "has 'extra'" in refused(written(actor_state_dict={**actor, "extra": torch.zeros(1)}))
    assert "is not finite" in refused(written(actor_state_dict={**actor, "mlp.0.bias": torch.full((32,), math.inf)}))
    torch.save({"something": 1}, tmp_path / "bad.pt")
    assert "has something; expected 'actor_state_dict'" in refused(str(tmp_path / "bad.pt"))
    (tmp_path / "bad.pt").write_bytes(b"\x1b[2Jnot a checkpoint")
    assert "cannot be read" in refused(str(tmp_path / "bad.pt"))


class Harmful:
    """What a stranger's checkpoint may hold."""

    def __reduce__(self):
        from pathlib import Path

        return Path.touch, (Path("harmed"),)


def test_nothing_in_a_checkpoint_is_run(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({**torch.load(path, weights_only=True), "infos": Harmful()}, tmp_path / "harmful.pt")
    assert "weights_only=True" in refused(str(tmp_path / "harmful.pt"))
    assert not (tmp_path / "harmed").exists()


def test_settings_that_cannot_be_are_refused_in_a_line(path):
    assert "kl_bound is 0" in refused(path, kl_bound=0.0)
    assert "multiplier_rate is -1" in refused(path, multiplier_rate=-1.0)
    assert "centring is 2" in refused(path, centring_rate=2.0)
    for setting in ("kl_bound", "multiplier_rate", "centring_rate"):  # what YAML makes of 5e-2
        assert "is '5e-2'; expected a" in refused(path, **{setting: "5e-2"})
    assert "multiplier_rate is inf" in refused(path, multiplier_rate=math.inf)
    assert "kl_bound is None" in refused(path, kl_bound=None)
    from hts_rsl_rl.ppo import ONCE_A_BATCH

    if ONCE_A_BATCH:  # a setting of rsl_rl 5.5 or newer
        assert "does not support use_mixed_precision" in refused(path, use_mixed_precision=True)
