"""The reward term of `integrations/rsl_rl` on a stand-in for an env: memory, centre, joints, Isaac Lab's manager."""

from __future__ import annotations

import importlib
import inspect
import sys
import types
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from hts.channels import Channel
from hts.contracts import ModelContext, Signals
from hts.measurement.export import export_model
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.transform import MeasurementTransform
from hts.plugins import load
from hts.recordings.recording import Series
from hts.rl import MeasuredReward
from hts.testing.known_signals import HEAT, KnownHeat, known_heat

INTEGRATION = Path(__file__).resolve().parents[2] / "integrations" / "rsl_rl"
TORQUE, SPEED = Channel("joint_torque", "N*m", (3,)), Channel("joint_velocity", "rad/s", (3,))
SIGNALS = Signals((TORQUE, SPEED), HEAT, 50.0)
WORLDS, STEPS = 4, 30


@pytest.fixture(scope="module")
def model() -> Linear:
    """Fitted to the known heat, with the names that joints have."""
    recordings = []
    for seed in (1, 2):
        known = known_heat(seed, seconds=6.0)
        named = {TORQUE.name: (TORQUE, "effort"), SPEED.name: (SPEED, "rate"), HEAT.name: (HEAT, "heat")}
        series = {name: Series(channel, known.values(old)) for name, (channel, old) in named.items()}
        recordings.append(known_heat(seed, seconds=6.0, channels=series))
    found = load().make_measurement_model("linear", LinearSettings().model_dump(), ModelContext(SIGNALS))
    found.fit(recordings)
    return found


@pytest.fixture(scope="module")
def exported(model, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("exported") / "m.safetensors"
    return str(export_model(model, KnownHeat(), path, joint_names=("x", "y", "z")))


@pytest.fixture
def reward(monkeypatch):
    monkeypatch.syspath_prepend(str(INTEGRATION))
    yield importlib.import_module("hts_rsl_rl.reward")
    for name in [name for name in sys.modules if name.split(".")[0] == "hts_rsl_rl"]:
        del sys.modules[name]


class Env:
    """As much of a manager-based env as a term asks for; its joints are in another order than the recordings'."""

    num_envs, device, step_dt = WORLDS, "cpu", 0.02
    names = ("z", "x", "y")

    def __init__(self) -> None:
        self.data = types.SimpleNamespace(torque=torch.zeros(WORLDS, 3), speed=torch.zeros(WORLDS, 3))
        self.scene = {"robot": types.SimpleNamespace(joint_names=list(self.names), data=self.data)}

    def show(self, torque: torch.Tensor, speed: torch.Tensor) -> None:
        """Values in the recordings' order x, y, z."""
        order = ["xyz".index(name) for name in self.names]
        self.data.torque, self.data.speed = torque[:, order], speed[:, order]


FIELDS = {"joint_torque": "torque", "joint_velocity": "speed"}


def steps():
    random = torch.Generator().manual_seed(3)
    for _ in range(STEPS):
        torque, speed = torch.randn(2, WORLDS, 3, generator=random)
        yield torque, speed, torch.rand(WORLDS, generator=random) < 0.15


def test_a_term_is_the_measured_reward_of_hts_before_weight_and_control_step(model, exported, reward):
    """Transform and centre as they are in hts's env, against the term; joints sorted by their names."""
    env, weight = Env(), 3.0
    term = reward.term_of({"model": exported}, env, FIELDS)
    transform = MeasurementTransform.of(KnownHeat(), model)
    transform.prepare(WORLDS, torch.device("cpu"))
    added = MeasuredReward(weight, env.step_dt, in_key="r")
    for torque, speed, over in steps():
        env.show(torque, speed)
        entries = transform.evaluate(torch.cat((torque, speed), 1))
        wanted = TensorDict({"r": entries["real_reward", "cool"], "reward": torch.zeros(WORLDS, 1)}, [WORLDS])
        added._with_reward(wanted)
        torch.testing.assert_close(weight * env.step_dt * term(env), wanted["reward"].squeeze(-1), atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(term.seen.measured, entries["measured", "heat"].squeeze(-1), atol=1e-5, rtol=1e-5)
        transform.forget(over)
        term.reset(over.nonzero().squeeze(-1))  # indices, as managers give them


def test_an_instance_that_begins_anew_forgets_and_the_others_do_not(exported, reward):
    env = Env()
    term = reward.term_of({"model": exported, "centring": None}, env, FIELDS)
    empty = term.state.clone()
    for torque, speed, _ in steps():
        env.show(torque, speed)
        term(env)
    before = term.state.clone()
    term.reset([1, 3])
    assert torch.equal(term.state[[1, 3]], empty[[1, 3]]) and torch.equal(term.state[[0, 2]], before[[0, 2]])
    assert not torch.equal(before, empty)
    term.reset(slice(None))
    assert torch.equal(term.state, empty)


def test_an_order_of_joints_is_given_and_never_guessed(model, exported, tmp_path, reward):
    env = Env()
    assert reward.joint_order("f", None, ("x", "y", "z"), env.names) == [1, 2, 0]
    assert reward.joint_order("f", ("z", "y", "x"), ("x", "y", "z"), env.names) == [0, 2, 1]
    nameless = str(export_model(model, KnownHeat(), tmp_path / "nameless.safetensors"))
    with pytest.raises(reward.ModelFileError, match="does not say in which order"):
        reward.term_of({"model": nameless}, env, FIELDS)
    with pytest.raises(reward.ModelFileError, match="joint 'knee' is not in this env, which has z, x, y"):
        reward.term_of({"model": exported, "joint_names": ("knee", "y", "z")}, env, FIELDS)


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"joint_names": ("x", "y", "y")}, "joint 'y' is named twice"),
        (
            {"channels": {"torque": lambda env: env.data.torque}},
            "where 'torque' is in this env, .* reads joint_torque, ",
        ),
        (
            {"channels": {"joint_torque": lambda env: env.data.torque.T}},
            r"has the shape \(3, 4\) .* 4 env instances first",
        ),
    ],
)
def test_params_that_would_be_read_as_other_numbers_are_refused(exported, reward, params, said):
    with pytest.raises(reward.ModelFileError, match=said):
        reward.term_of({"model": exported, **params}, Env(), FIELDS)(Env())


def test_numbers_of_another_precision_are_read_as_those_of_hts(exported, reward):
    found = []
    for dtype in (torch.float32, torch.float64, torch.float16):
        env = Env()
        env.show(torch.full((WORLDS, 3), 2.5, dtype=dtype), torch.full((WORLDS, 3), -0.5, dtype=dtype))
        found.append(reward.term_of({"model": exported, "centring": None}, env, FIELDS)(env))
    assert all(one.dtype == torch.float32 and torch.equal(one, found[0]) for one in found)


def test_what_is_not_finite_stops_the_training_with_the_instance_named(exported, reward):
    env = Env()
    term = reward.term_of({"model": exported}, env, FIELDS)
    torque = torch.zeros(WORLDS, 3)
    torque[2, 1] = torch.inf
    env.show(torque, torch.zeros(WORLDS, 3))
    with pytest.raises(reward.ModelFileError, match="env instance 2 is"):
        term(env)


def test_isaac_labs_manager_takes_the_term(exported, reward, monkeypatch):
    """By its rules: a class of ManagerTermBase, made with cfg and env, and called with the params by name; every
    parameter of the call is among the params or has a default."""

    class ManagerTermBase:
        def __init__(self, cfg, env):
            self.cfg, self._env = cfg, env

    managers = types.ModuleType("isaaclab.managers")
    managers.ManagerTermBase = ManagerTermBase
    monkeypatch.setitem(sys.modules, "isaaclab", types.ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.managers", managers)
    module = importlib.import_module("hts_rsl_rl.isaaclab")
    assert module.IN_JOINTS["joint_torque"] == "applied_torque"
    env = Env()
    env.data.applied_torque = env.data.joint_vel = torch.ones(WORLDS, 3)
    params = {"model": exported, "centring": None}
    term = module.MeasuredReward(types.SimpleNamespace(params=params), env)
    named = dict(list(inspect.signature(term).parameters.items())[1:])
    assert set(params) <= set(named) and all(one.default is not inspect.Parameter.empty for one in named.values())
    found = term(env, **params)
    assert found.shape == (WORLDS,) and torch.isfinite(found).all()
    term.reset(env_ids=[0])
