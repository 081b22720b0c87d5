"""Worlds of the velocity env: randomised, pushed, broken, seeded, saved and gone on with."""

from __future__ import annotations

import pytest
import torch
from stepping import MIXED, roll, step, still

from hts.config import RandomisationConfig
from hts.errors import SimulationError

pytest.importorskip("hts_go1", reason="the robot of these tests is not installed")


# --------------------------------------------------------------------------------------------- randomisation


def numbers(model):
    return (model.body_mass[1], *model.body_ipos[1], model.geom("floor").friction[0], *model.actuator_gainprm[:, 0])


def test_a_candidate_meets_the_same_worlds_whoever_trains_beside_it(make):
    alone, crowd = make(1, 5, randomisation=MIXED), make(3, 5, randomisation=MIXED)
    for world in range(15):
        assert numbers(alone.engine.models[world % 5]) == numbers(crowd.engine.models[world])
    assert torch.equal(alone.delay, crowd.delay) and torch.equal(alone.joint_offset, crowd.joint_offset)


def test_worlds_differ_within_the_ranges_of_the_configuration(make):
    ranges = RandomisationConfig(models=24)
    env = make(1, 24, randomisation=ranges)
    models = env.engine.models
    masses = [model.body_mass[1] - 5.56 for model in models]
    frictions = [model.geom("floor").friction[0] for model in models]
    losses = [model.dof_frictionloss[6] / 0.2 for model in models]
    for values, (low, high) in (
        (masses, ranges.added_mass),
        (frictions, ranges.friction),
        (losses, ranges.joint_friction),
    ):
        assert low <= min(values) and max(values) <= high
        assert max(values) - min(values) > 0.6 * (high - low)
    assert set(env.delay.flatten().tolist()) == {0, 1, 2, 3}


def test_without_randomisation_every_world_is_the_nominal_robot(make):
    env = make(1, 3)
    assert all(model.body_mass.sum() == pytest.approx(13.0994, abs=1e-4) for model in env.engine.models)
    assert not env.delay.any() and not env.joint_offset.any()


def test_pushes_come_as_often_and_as_hard_as_configured(make):
    push = RandomisationConfig(models=1, push_speed=0.5, push_interval=0.2)  # one step in ten
    env = make(1, 400, randomisation=push)
    env.reset()
    before = env.engine.qvel.clone()
    draws = torch.rand(1, 400, 3, generator=torch.Generator().manual_seed(0))
    env.disturbances.act(draws)
    change = (env.engine.qvel - before)[:, :3]
    pushed = change.any(-1)
    assert torch.equal(pushed, draws[0, :, 0] < 0.1)
    assert change[pushed].abs().max() <= 0.5 and not change[:, 2].any()


def test_a_pull_is_felt_in_the_physics_and_goes_on_from_a_saved_state(make):
    pulled = RandomisationConfig(models=1, push_speed=0.0, pull=0.4, pull_seconds=0.1)
    env, calm = make(1, 8, randomisation=pulled), make(1, 8, randomisation=pulled.model_copy(update={"pull": (0.0,)}))
    actions = [still(env)] * 20
    last = [roll(one, actions)[0][-1]["observation"] for one in (env, calm)]
    assert not torch.equal(*last)
    assert env.disturbances.pull.any() and env.disturbances.pull.abs().max() <= 0.4
    saved, pull = env.full_state(), env.disturbances.pull.clone()
    env.disturbances.pull = torch.zeros_like(pull)
    env.load_full_state(saved)
    assert torch.equal(env.disturbances.pull, pull)


# ------------------------------------------------------------------------------------------- broken physics


def test_a_world_whose_physics_breaks_has_fallen_and_shows_no_bad_number(make):
    env = make(1, 3)
    actions = [still(env)] * 4
    healthy, _ = roll(env, actions)
    env.set_seed(0)
    other = make(1, 3)
    state = other.reset()
    other.engine._state[1, 1 + 19 :] = 1e12  # rad/s: MuJoCo gives up on this world
    seen, _ = roll(other, actions, state)
    first = seen[0]
    assert first["terminated"].flatten().tolist() == [False, True, False]
    assert float(first["reward"][0, 1]) == -1.0  # termination, -50 x 0.02
    for after in seen:
        for value in after.flatten_keys().values():
            assert torch.isfinite(value.float()).all()
    for after, undisturbed in zip(seen, healthy, strict=True):
        assert torch.equal(after["observation"][0, ::2], undisturbed["observation"][0, ::2])
    assert other.breakdowns.flatten().tolist() == [0.0, 1.0, 0.0]
    assert not seen[-1]["terminated"].any()


def test_a_push_does_not_hide_broken_physics(make):
    env = make(1, 2, randomisation=RandomisationConfig(models=1, push_interval=1e-6))  # always
    env.reset()
    env.engine._state[1, 1 + 19 :] = 1e12
    assert step(env)["terminated"].flatten().tolist() == [False, True]


def test_an_action_that_is_not_finite_stops_before_the_physics(make):
    env = make(1, 2)
    env.reset()
    action = still(env)
    action[0, 1, 3] = float("nan")
    with pytest.raises(SimulationError, match=r"non-finite actuator input.*\[1\]"):
        step(env, action)


# ------------------------------------------------------------------------------------- streams and saving


def wild(candidates: int, seed: int = 0) -> torch.Tensor:
    """Actions that make robots fall, (40, candidates, 3, 12), equal for every candidate."""
    return 3 * torch.randn(40, 1, 3, 12, generator=torch.Generator().manual_seed(seed)).expand(40, candidates, 3, 12)


def test_a_candidate_sees_the_same_alone_and_in_a_crowd(make):
    settings = {"randomisation": MIXED, "observation_noise": 1.0, "episode_seconds": 0.5}
    alone, _ = roll(make(1, 3, seeds=[7], **settings), wild(1))
    crowd, _ = roll(make(3, 3, seeds=[1, 7, 2], **settings), wild(3))
    assert sum(int(after["terminated"].sum()) for after in alone) > 0  # robots fell, episodes began anew
    for one, many in zip(alone, crowd, strict=True):
        many = many[1:2]
        for key, value in one.items(True, True):
            assert torch.equal(value, many[key]), key
    assert not torch.equal(crowd[-1]["observation"][0], crowd[-1]["observation"][1])


def test_an_env_goes_on_exactly_from_its_saved_state(make):
    settings = {"randomisation": MIXED, "observation_noise": 1.0, "episode_seconds": 0.5}
    env = make(2, 3, **settings)
    _, state = roll(env, wild(2)[:15])
    saved = env.full_state().clone()
    expected, _ = roll(env, wild(2)[15:], state)
    other = make(2, 3, **settings)
    other.reset()
    step(other, wild(2)[0])
    other.go_on(saved)
    went_on, _ = roll(other, wild(2)[15:])  # begins with a reset, as a collector does
    for one, two in zip(expected, went_on, strict=True):
        for key, value in one.items(True, True):
            assert torch.equal(value, two[key]), key


def test_a_state_of_another_number_of_worlds_is_refused(make):
    small, large = make(1, 2), make(1, 3)
    for env in (small, large):
        env.reset()
    with pytest.raises(SimulationError, match="another number of worlds"):
        large.load_full_state(small.full_state())


def test_a_seed_decides_the_next_reset(make):
    env = make(1, 2)
    seen = []
    for seed in (3, 3, 4):
        env.set_seed(seed)
        seen.append(env.reset()["observation"].clone())
    assert torch.equal(seen[0], seen[1]) and not torch.equal(seen[0], seen[2])
