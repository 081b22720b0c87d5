"""Programs: what a function does to tensors, written down once and run instead of it."""

import functools

import pytest
import torch

from hts.channels import Channel
from hts.config import EnvConfig
from hts.contracts import Signals
from hts.errors import SimulationError
from hts.guarded import guarded
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.transform import MeasurementTransform
from hts.policies.files import load_policy
from hts.rl import tracing
from hts.rl.actor import PopulationActor
from hts.rl.captured_collector import CapturedCollector, _traced
from hts.rl.population import Population
from hts.rl.random import PopulationRandom
from hts.rl.tracing import TracedGraph, any_or_tracing
from hts.rl.tracing import compiled as compile_it
from hts.training.finetune import measured_env
from hts_go1.plugin import make_go1

CHANNELS = ("joint_torque", "joint_velocity")
HORIZON = 8


class Counter:
    """Holds a number in an attribute, replaces it at every step, and copies it back to where it was."""

    def __init__(self):
        self.value = self.place = torch.zeros(3)

    def step(self, add):
        self.value = self.value + add
        self.place.copy_(self.value)
        self.value = self.place
        return self.value * 2.0


def test_a_program_changes_the_memory_that_its_function_changes():
    counter = Counter()
    program = TracedGraph(lambda add, _: counter.step(add), [torch.ones(3), counter.place], compiled=False)
    assert counter.place.tolist() == [0.0, 0.0, 0.0]  # recording leaves what it was given as it was
    assert program(torch.full((3,), 2.0), counter.place).tolist() == [4.0, 4.0, 4.0]
    assert program(torch.ones(3), counter.place).tolist() == [6.0, 6.0, 6.0]
    assert counter.place.tolist() == [3.0, 3.0, 3.0]


def test_a_program_takes_both_ways_of_a_mask_that_was_empty_when_it_was_recorded():
    def clipped(x):
        large = x > 1.0
        return torch.where(large, 1.0, x) if any_or_tracing(large) else x

    program = TracedGraph(clipped, [torch.zeros(2)], compiled=False)
    assert program(torch.tensor([0.5, 3.0])).tolist() == [0.5, 1.0]


def test_a_value_read_while_recording_is_an_error_and_not_a_constant_of_the_program():
    with pytest.raises(RuntimeError, match="value out of a tracing tensor"):
        TracedGraph(lambda x: x if float(x.sum()) > 0 else -x, [torch.ones(2)], compiled=False)


class Doubler:
    def double(self, x, *, times=2.0):
        return x * times


@pytest.mark.parametrize(
    ("named", "programs", "found"),
    [
        (None, ["gcc"], "/bin/gcc"),
        ("", ["cc", "gcc"], "/bin/cc"),
        (None, [], None),
        ("icx", ["icx", "gcc"], "/bin/icx"),
        ("ccache gcc", ["ccache", "gcc"], None),  # Triton calls it as one name
        ("1559b7c", ["gcc"], None),
    ],
)
def test_only_a_compiler_that_can_be_called_counts(named, programs, found, monkeypatch):
    said = []
    monkeypatch.setattr(tracing.logger, "warning", lambda text, *values: said.append(text % values))
    monkeypatch.setattr(tracing.shutil, "which", {name: f"/bin/{name}" for name in programs}.get)
    monkeypatch.delenv("CC", raising=False)
    if named is not None:
        monkeypatch.setenv("CC", named)
    tracing._c_compiler.cache_clear()
    try:
        assert tracing._c_compiler() == tracing._c_compiler() == found
    finally:
        tracing._c_compiler.cache_clear()
    wrong = bool(named) and found is None
    assert len(said) == wrong and all(f"CC={named}: expected the name of a C compiler" in text for text in said)


def test_however_many_shapes_a_process_trains_each_is_compiled(monkeypatch):
    compiled = []

    def backend(graph, inputs):
        compiled.append(tuple(inputs[0].shape))
        return graph.forward

    monkeypatch.setattr(torch, "compile", functools.partial(torch.compile, backend=backend))
    wanted = [(size,) for size in range(2, 14)]
    for shape in wanted:
        double = compile_it(Doubler().double, torch.device("cpu"), wanted=True)
        assert double(torch.ones(shape)).tolist() == [2.0] * shape[0]
    assert compiled == wanted


def make_rollout() -> CapturedCollector:
    """Two candidates of six worlds with episodes of five steps, as a GPU would run them."""
    robot = make_go1({})
    config = EnvConfig(episode_seconds=0.1, device="cpu", randomisation={"models": 2})
    env = robot.make_env("warp", 2, 6, config, channels=CHANNELS, seeds=[3, 4])
    signals = Signals(tuple(Channel(name, "1", (12,)) for name in CHANNELS), Channel("t", "N*m"), 50.0)
    model = LSTM(LSTMSettings(hidden=8), signals, seed=1)
    some = torch.randn(50, 25, generator=torch.Generator().manual_seed(0))
    model.set_statistics(some[:, :24] * 5, some[:, 24])
    policy = load_policy(robot.pretrained_policy())
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors] * 2)
    population.refresh()
    env = measured_env(env, [MeasurementTransform(model, lambda x: -x, "cost")])
    noise = PopulationRandom([5, 6], torch.device("cpu"))
    return CapturedCollector(
        env,
        PopulationActor(population, noise),
        frames_per_batch=2 * 6 * HORIZON,
        capture=False,
        side_stream=True,
        reference=population.frozen(),
    )


def test_a_reward_that_reads_a_value_is_named_with_what_to_do():
    def part():
        reward = torch.ones(3)
        return (-reward if float(reward.sum()) > 0.5 else reward,)

    with pytest.raises(SimulationError, match=r"waits for the device.*ppo\.capture=false"):
        _traced(part, [], [torch.zeros(1)], compiled=False)


def test_a_model_that_reads_a_value_is_named_with_what_to_do():
    def part():
        seen = torch.ones(3)
        return (guarded("Measurement model 'mine': step()", lambda: -seen if float(seen.sum()) > 0.5 else seen),)

    with pytest.raises(SimulationError, match=r"waits for the device, Measurement model 'mine': step\(\)\. .*ppo\.cap"):
        _traced(part, [], [torch.zeros(1)], compiled=False)


def test_control_steps_written_down_are_the_control_steps_to_the_bit():
    pytest.importorskip("mujoco_warp", reason="extra gpu is not installed")
    batches = []
    for written in (False, True):
        rollout = make_rollout()
        engine = rollout.bare_env.engine
        rollout.update_policy_weights_()
        for transform in rollout.transforms:
            transform.prepare(12, engine.device)
        rollout.bare_env.reset()
        physics = engine.state_dict()
        buffers = rollout._hold_state()
        rollout._one_step()
        if written:
            rollout._trace(buffers, compiled=False)
        for one in buffers:
            one.restore()
        engine.load_state_dict(physics)
        rollout._rows.clear()
        for _ in range(2):
            for random in rollout._randoms():
                random.renew()
            rollout._time.zero_()
            for _ in range(HORIZON):
                engine.load(rollout._before())
                rollout._beside()
                engine.launch()
                rollout._after()
        batches.append({key: rows.clone() for key, rows in rollout._rows.items()})
        rollout.env.close()
    plain, traced = batches
    assert plain.keys() == traced.keys() and ("next", "real_reward", "cost") in plain
    assert plain["next", "truncated"].any()  # episodes have ended, so that new ones are compared too
    for key, rows in plain.items():
        assert torch.equal(traced[key], rows), key
