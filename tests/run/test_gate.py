"""The gate before reality: what it measures, whom it refuses, and that nobody passes it by."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest
import torch
from pydantic import ValidationError
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from hts.channels import Channel
from hts.config import GateConfig, RunConfig
from hts.config_loading import load_config
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.errors import ConfigError, SimulationError
from hts.plugins import load
from hts.rl.population import Population, Sizes
from hts.run import gate, judging
from hts.run.gate_checks import CHECKS, Worst, check_told, sentence, told_by, untold_by
from hts.run.gate_trials import LostPackets, commands_of, rollout
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SPEC = RobotSpec.log_only(
    "arm",
    ["lift", "turn"],
    torque_limit=[10.0, 20.0],
    velocity_limit=[4.0, 4.0],
    position_limit=[(-1.0, 1.0), (-2.0, 2.0)],
    rate_hz=50.0,
)
CHANNELS = {
    "joint_torque": Channel("joint_torque", "N*m", (2,)),
    "joint_position": Channel("joint_position", "rad", (2,)),
    "projected_gravity": Channel("projected_gravity", "1", (3,)),
    "joint_target": Channel("joint_target", "rad", (2,)),
}
NO_LOSS = (0.0, 0.0)


class Scripted(EnvBase):
    """Two policies in four instances; what the channels say at a step is up to the test."""

    def __init__(self, say) -> None:
        super().__init__(batch_size=torch.Size([2, 4]))
        self.dt, self.clock, self.say, self.received = 0.02, 0, say, []
        shape = self.batch_size
        self.observation_spec = Composite(
            observation=Unbounded((*shape, 3)),
            channels=Composite({n: Unbounded((*shape, *c.shape)) for n, c in CHANNELS.items()}, shape=shape),
            shape=shape,
        )
        self.action_spec, self.reward_spec = Unbounded((*shape, 2)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)

    def _set_seed(self, seed):
        pass

    def _reset(self, tensordict=None, **kwargs):
        return self._write(resets=True)

    def _step(self, tensordict):
        self.clock += 1
        self.received.append(tensordict["action"].clone())
        return self._write(reward=torch.zeros(*self.batch_size, 1))

    def _write(self, resets=False, **entries):
        values = {name: torch.zeros(*self.batch_size, *channel.shape) for name, channel in CHANNELS.items()}
        values["projected_gravity"][..., 2] = -1.0
        fell = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        self.say(self.clock, values, fell)
        fell &= not resets
        flags = {"terminated": fell, "done": fell.clone(), "truncated": torch.zeros_like(fell)}
        content = {"observation": torch.zeros(*self.batch_size, 3), "channels": values, **flags, **entries}
        return TensorDict(content, batch_size=self.batch_size)


def tried(say, **settings):
    config = GateConfig(seconds=3.0, lost_packets=NO_LOSS, **settings)
    population = Population(Sizes(3, 3, 2, (4,)), 2)
    return rollout(Scripted(say), population, SPEC, CHECKS, config, (0.5, 1.0), LostPackets(NO_LOSS, 4, 0))


def quiet(clock, values, fell):
    """Nothing moves."""


def test_a_machine_that_does_nothing_passes_every_check():
    for row in tried(quiet):
        assert set(row) == set(CHECKS) and all(worst.passed for worst in row.values())
        assert row["joint_range"].value == pytest.approx(1.0) and row["tilt"].value == pytest.approx(0.0, abs=1e-3)


def test_torque_is_the_share_of_the_time_at_the_limit_of_the_joint_and_instance_where_it_is_largest():
    def say(clock, values, fell):
        # 100 of 150 steps are judged; joint `turn` is at 19 of 20 N·m in half of them, in instance 3 of policy 1.
        values["joint_torque"][1, 3, 1] = -19.0 if clock > 100 else 0.0
        values["joint_torque"][0, 0, 1] = 17.9  # 0.895 of the limit: below the level

    good, bad = tried(say)
    assert good["torque"].passed and good["torque"].peak == pytest.approx(0.895)
    worst = bad["torque"]
    assert not worst.passed and worst.value == pytest.approx(0.5, abs=0.01)
    assert (worst.joint, worst.instance, worst.set_point) == ("turn", 3, 1.0)
    assert worst.peak == pytest.approx(0.95)


def test_range_and_tilt_keep_their_worst_moment_and_say_when_it_was():
    lean = math.radians(30.0)

    def say(clock, values, fell):
        values["joint_position"][0, 2, 0] = 0.97 if clock == 75 else 0.0
        values["projected_gravity"][1, 1] = torch.tensor(
            [math.sin(lean), 0.0, -math.cos(lean)] if clock == 125 else [0.0, 0.0, -1.0]
        )

    first, second = tried(say)
    assert not first["joint_range"].passed and first["joint_range"].value == pytest.approx(0.03, abs=1e-5)
    assert (first["joint_range"].joint, first["joint_range"].second) == ("lift", 1.5)
    assert not second["tilt"].passed and second["tilt"].value == pytest.approx(30.0, abs=0.01)
    assert (second["tilt"].second, second["tilt"].joint, second["tilt"].set_point) == (2.5, None, 1.0)


def test_action_rate_is_the_root_mean_square_of_the_targets_rate_over_the_velocity_limit():
    def say(clock, values, fell):
        values["joint_target"][0, 1, 0] = 0.08 * (clock % 2)  # ±0.08 rad in 0.02 s: 4 rad/s, the velocity limit

    first, second = tried(say)
    assert first["action_rate"].value == pytest.approx(1.0, rel=1e-4) and not first["action_rate"].passed
    assert second["action_rate"].value == 0.0


def test_a_fall_counts_from_the_start_and_nothing_after_it_does():
    def say(clock, values, fell):
        fell[1, 2] = clock == 10  # before anything else is judged
        values["joint_torque"][1, 2, 0] = 10.0  # its numbers after the fall mean nothing

    _, bad = tried(say)
    assert not bad["falls"].passed and bad["falls"].value == 1 and bad["falls"].second == 0.2
    assert bad["torque"].passed and bad["torque"].value == 0.0


def test_the_drop_at_the_beginning_is_not_judged():
    def say(clock, values, fell):
        values["joint_torque"][..., 0] = 10.0 if clock <= 50 else 0.0

    assert all(row["torque"].value == 0.0 for row in tried(say))


def test_a_number_that_is_none_stops_it():
    def say(clock, values, fell):
        values["joint_position"][0, 0, 0] = math.nan if clock == 100 else 0.0

    with pytest.raises(SimulationError, match="joint_range met NaN in the channel 'joint_position' of robot 'arm'"):
        tried(say)


def test_a_lost_packet_leaves_the_last_action_for_every_policy_alike():
    lost = LostPackets((0.5, 0.5), 50, seed=3)
    first = lost(torch.zeros(2, 50, 1))
    second = lost(torch.ones(2, 50, 1))
    assert not first.any()
    assert 10 < second[0].sum() < 40 and torch.equal(second[0], second[1])
    never = LostPackets((1.0, 1.0), 4, seed=0)
    never(torch.zeros(1, 4, 1))
    assert not never(torch.ones(1, 4, 1)).any()


def test_what_is_said_of_a_refused_one_names_what_how_much_and_where(tmp_path):
    robot = load().make_robot("go1")
    worst = Worst("torque", 0.034, 0.01, "FL_calf_joint", 1.1, 7, dynamics={"friction": 0.31, "latency": 0.02})
    assert sentence("00-03", worst, GateConfig(), robot) == (
        "00-03 is refused by the gate: FL_calf_joint is at 90% of its 35.55 N·m or above for 3.4% of the time "
        "(allowed: 1.0%) at 1.1 m/s with friction 0.31, latency 20 ms"
    )


def log_only(*names: str) -> LogOnlyRobot:
    return LogOnlyRobot(SPEC, [CHANNELS[name] for name in names])


def test_only_what_channels_and_limits_allow_can_be_told():
    assert told_by(log_only(*CHANNELS)) == CHECKS
    assert told_by(log_only("joint_torque")) == ("falls", "torque")
    assert untold_by(log_only("joint_torque")) == ("joint_range", "tilt", "action_rate")
    for check, limits in (
        ("torque", {"torque_limit": (math.inf, 1.0)}),
        ("torque", {"torque_limit": (0.0, 1.0)}),
        ("joint_range", {"position_limit": ((-1.0, 1.0), (0.0, 0.0))}),
        ("action_rate", {"velocity_limit": (math.inf, 1.0)}),
    ):
        assert untold_by(LogOnlyRobot(dataclasses.replace(SPEC, **limits), CHANNELS.values())) == (check,)


def test_a_machine_whose_env_cannot_tell_needs_a_persons_word():
    config: RunConfig = load_config(objectives=["power"], robot="go1", preset="smoke")
    robot = log_only("joint_torque", "joint_position")

    class Machine:
        simulated = None

    with pytest.raises(ConfigError, match=r"cannot tell tilt .*accept_untold=\[tilt,action_rate\]"):
        check_told(config, robot, Machine())
    trusting = config.model_copy(update={"gate": GateConfig(accept_untold=("tilt", "action_rate"))})
    check_told(trusting, robot, Machine())
    Machine.simulated = True
    check_told(config, robot, Machine())


@pytest.mark.parametrize(
    "settings",
    [
        {"friction": (1.0, 0.5)},
        {"gains": (0.0, 1.0)},
        {"latency": (0.0, 1.5)},
        {"lost_packets": (-0.1, 0.1)},
        {"payload": (0.0, math.inf)},
        {"tilt": 0},
        {"accept_untold": ("falls",)},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(ValidationError):
        GateConfig(**settings)


# ------------------------------------------------------------------------------------------------ in a run


def outcomes(monkeypatch, fails):
    """The gate finds what `fails` says of each policy; everything else of it stays."""
    asked = []
    of = gate.Trials.of

    def pretend(self, names):
        asked.append(list(names))
        rows = of(self, names)
        for name in names:
            if fails(name):
                rows[name] |= {
                    "passed": False,
                    "failed": ["tilt"],
                    "refused": f"{name} is refused by the gate: made up",
                }
        return rows

    monkeypatch.setattr(gate.Trials, "of", pretend)
    return asked


STRICT = {"sweep.kl_bounds": [0.5, 1.0, 2.0], "gate.strict": True}


def run(path, **settings):
    with kit_installed():
        return tiny_run(path, settings={**STRICT, **settings})


def test_who_fails_is_replaced_by_the_next_best_and_never_tried(run_on, tmp_path, monkeypatch, capsys):
    asked = outcomes(monkeypatch, lambda name: name == asked[0][0])
    found = run_on("iterations/00/gate", tmp_path / "run", STRICT)
    result = json.loads((tmp_path / "run/iterations/00/gate.json").read_text())
    first = asked[0][0]
    assert result["proposed"] == [first] and result["policies"][first]["passed"] is False
    assert len(result["elites"]) == 1 and first not in result["elites"]
    assert asked[-1] == ["pretrained"] and result["pretrained"]["passed"]
    iteration = found.summary["iterations"][0]
    assert [row["id"] for row in iteration["candidates"] if row["elite"]] == result["elites"]
    assert iteration["gate"]["refused"] == [first]
    assert f"{first} is refused by the gate: made up" in iteration["warnings"]
    assert f"iteration 00: {first} is refused by the gate: made up" in " ".join(capsys.readouterr().out.split())
    assert result["first_run"] == {"speed_scale": 0.5, "torque_scale": 0.7, "seconds": 20.0}
    row = next(row for row in iteration["candidates"] if row["id"] == first)
    assert row["gate"]["failed"] == ["tilt"] and row["real"] is None


def test_who_ended_as_the_same_policy_does_not_move_up(tmp_path, monkeypatch):
    """No bound held back the first two, so they are one policy; where another fails, who moves up is somebody else."""
    alike = judging.same_policies

    def first_two(rows):
        return alike([row | {"policy_hash": "one"} if row["id"] in ("00-00", "00-01") else row for row in rows])

    for module in (judging, gate):
        monkeypatch.setattr(module, "same_policies", first_two)
    asked = outcomes(monkeypatch, lambda name: name == asked[0][1])
    run(tmp_path / "run", **{"sweep.kl_bounds": [0.1, 0.2, 0.5, 1.0], "selection.elites": 2})
    result = json.loads((tmp_path / "run/iterations/00/gate.json").read_text())
    assert result["kept_out"] == {"00-01": "ended as the same policy as an earlier candidate"}
    assert len(result["elites"]) == 2 and "00-01" not in {*result["proposed"], *result["elites"]}


@pytest.mark.slow
def test_where_all_fail_nobody_is_tried_and_the_run_says_so(run_on, tmp_path, monkeypatch, capsys):
    asked = outcomes(monkeypatch, lambda name: True)
    found = run_on("iterations/00/gate", tmp_path / "run", STRICT)
    assert sorted(name for names in asked[:-1] for name in names) == ["00-00", "00-01", "00-02"]
    assert found.summary["final"]["policy"] == "pretrained"
    said = " ".join(capsys.readouterr().out.split())
    assert "the gate refused all 3 candidates that could be tried, so nobody is" in said
    assert "nobody was tested: the gate before reality refused 3" in said
    assert "the pretrained policy itself would not pass the gate (tilt)" in said
    assert "refused by the gate: made up" in (tmp_path / "run/report.html").read_text()


@pytest.mark.slow
def test_who_fell_while_being_judged_is_not_tried(tmp_path, monkeypatch):
    judge = judging._judge

    def all_but_the_last_fall(row, *rest):
        return dataclasses.replace(judge(row, *rest), falls=int(row["id"] != "00-02"))

    assert KnownWorld.simulated is True
    monkeypatch.setattr(judging, "_judge", all_but_the_last_fall)
    run(tmp_path / "run", **{"selection.elites": 3})
    result = json.loads((tmp_path / "run/iterations/00/gate.json").read_text())
    assert result["elites"] == ["00-02"]
    assert result["kept_out"]["00-00"] == "fell while being judged, in 1 env instance"
    note = json.loads((tmp_path / "run/iterations/00/candidates/00-00.gate.json").read_text())
    assert note["passed"] is False and note["failed"] == ["falls"]
    assert note["refused"] == "00-00: fell while being judged, in 1 env instance"


def test_a_simulated_world_tries_who_fails_and_says_what_a_machine_would_not_get(tmp_path, monkeypatch, capsys):
    asked = outcomes(monkeypatch, lambda name: name != "pretrained")
    found = run(tmp_path / "run", **{"gate.strict": None})
    result = json.loads((tmp_path / "run/iterations/00/gate.json").read_text())
    (elite,) = result["elites"]
    assert asked == [[elite], ["pretrained"]]
    assert result["strict"] is False and result["policies"][elite]["passed"] is False
    iteration = found.summary["iterations"][0]
    assert iteration["gate"]["refused"] == [elite]
    assert next(row for row in iteration["candidates"] if row["id"] == elite)["elite"]
    said = " ".join(capsys.readouterr().out.split())
    assert f"a machine would not get {elite}; this world is simulated, so they are tried" in said


@pytest.mark.slow
def test_a_run_without_a_gate_tries_whom_the_selector_chose(tmp_path):
    found = run(tmp_path / "run", **{"gate.enabled": False})
    assert not (tmp_path / "run/iterations/00/gate.json").exists()
    assert "gate" not in found.summary["iterations"][0]
    assert sum(row["elite"] for row in found.summary["iterations"][0]["candidates"]) == 1


def test_the_shipped_policy_passes_and_a_strict_gate_refuses_it_with_its_dynamics(tmp_path):
    """The real thing: a Go1 in the engine, with latency, friction, payload, gains and lost packets."""

    class FewestOfAJob:
        registry = load()
        config = load_config(objectives=["power"], robot="go1", preset="smoke").model_copy(
            update={"gate": GateConfig(num_envs=3, seconds=2.0)}
        )
        robot = registry.make_robot("go1")

        def seed(self, *what):
            return 7

        def policy(self, name):
            return gate_trials_policy(self.robot)

    job = FewestOfAJob()
    row = gate.Trials(job, {"trials": {}}).of(["pretrained"])["pretrained"]
    assert row["passed"], row["refused"]
    assert 0.0 < row["worst"]["tilt"]["value"] < 25.0 and 0.2 < row["worst"]["torque"]["peak"] < 0.9
    job.config = job.config.model_copy(update={"gate": GateConfig(num_envs=3, seconds=2.0, tilt=0.5)})
    row = gate.Trials(job, {"trials": {}}).of(["pretrained"])["pretrained"]
    assert row["failed"] == ["tilt"] and "the trunk tilts by" in row["refused"]
    known = row["worst"]["tilt"]["dynamics"]
    assert 0.3 <= known["friction"] <= 1.3 and -1.0 <= known["payload"] <= 3.0 and 0 <= known["latency"] <= 0.02
    assert 0.8 <= known["gains"] <= 1.2 and 0.0 <= known["lost_packets"] <= 0.05


def gate_trials_policy(robot):
    from hts.policies.files import load_policy

    return load_policy(robot.pretrained_policy(), robot.spec)


def test_who_fell_everywhere_takes_nobody_elses_command_away():
    """A command that nobody knows is null in simulate.json, NaN before it is written."""
    trials = {
        "walks": [{"commanded": 0.55}, {"commanded": 0.9}],
        "fell": [{"commanded": 0.45}, {"commanded": None}],
        "lies": [{"commanded": math.nan}, {"commanded": math.nan}],
    }
    sent = commands_of(trials, list(trials), (0.5, 0.8))
    assert torch.equal(sent, torch.tensor([[0.55, 0.9], [0.45, 0.8], [0.5, 0.8]]))
    assert commands_of(trials, ["lies"], (0.5, 0.8)) is None
