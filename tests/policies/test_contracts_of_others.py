"""What mjlab, Isaac Lab and others write beside a policy: read without running it, or asked for; never guessed."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from dog import FOUR as SPEC
from torch import nn

from hts.errors import ConfigError, PolicyError
from hts.policies.contract import Contract, per_joint
from hts.policies.importing import import_whole
from hts.policies.layout import Layout, load_layout
from hts.policies.params import source_beside
from hts.policies.source import sized
from hts.policies.translate import REACH
from hts.rl.population import Population

NAMES = SPEC.joint_names

MJLAB = """
decimation: 4
scene:
  entities:
    robot:
      init_state:
        pos: !!python/tuple [0.0, 0.0, 0.278]
        joint_pos: {.*calf: -1.8, .*R_hip: 0.1, .*L_hip: -0.1}
      spec_fn: !!python/name:mjlab.asset_zoo.robots.unitree_go1.go1_constants.get_spec ''
      articulation:
        actuators: !!python/tuple
        - target_names_expr: !!python/tuple [.*_hip]
          stiffness: 20.0
          damping: 0.5
          delay_min_lag: 0
          delay_max_lag: 2
        - target_names_expr: !!python/tuple [.*_calf]
          stiffness: 20.0
          damping: 0.5
          delay_min_lag: 1
          delay_max_lag: 2
sim:
  mujoco: {timestep: 0.005}
observations:
  actor:
    terms:
      base_ang_vel:
        func: !!python/name:mjlab.envs.mdp.observations.builtin_sensor ''
        params: {sensor_name: robot/imu_ang_vel}
        noise: !!python/object:mjlab.utils.noise.UniformNoiseCfg {n_min: -0.2, n_max: 0.2}
        scale: null
        clip: null
        history_length: 0
      projected_gravity: {func: !!python/name:mjlab.envs.mdp.observations.projected_gravity '', params: {}, scale: null}
      joint_pos: {func: !!python/name:mjlab.envs.mdp.observations.joint_pos_rel '', params: {biased: true}, scale: null}
      joint_vel: {func: !!python/name:mjlab.envs.mdp.observations.joint_vel_rel '', params: {}, scale: 0.05}
      actions: {func: !!python/name:mjlab.envs.mdp.observations.last_action '', params: {}, scale: null}
      command: {func: !!python/name:mjlab.envs.mdp.observations.generated_commands '', params: {command_name: twist}}
actions:
  joint_pos:
    actuator_names: !!python/tuple [.*]
    scale: {.*_hip: 0.3, .*_calf: 0.2}
    use_default_offset: true
    clip: null
"""
ISAAC = """
sim: {dt: 0.005}
decimation: 4
scene:
  robot:
    init_state: {joint_pos: {.*L_hip: 0.1, .*R_hip: -0.1, .*_calf: -1.5}}
    actuators:
      base_legs:
        class_type: isaaclab.actuators.actuator_pd:DelayedPDActuator
        joint_names_expr: [.*]
        stiffness: 20.0
        damping: {.*_hip: 0.5, .*_calf: 0.5}
        min_delay: 0
        max_delay: 4
observations:
  policy:
    concatenate_terms: true
    history_length: null
    base_ang_vel:
      {func: 'isaaclab.envs.mdp.observations:base_ang_vel', params: {}, clip: null, scale: 0.25, history_length: 0}
    projected_gravity: {func: 'isaaclab.envs.mdp.observations:projected_gravity', params: {}, scale: null}
    velocity_commands:
      {func: 'isaaclab.envs.mdp.observations:generated_commands', params: {command_name: base_velocity}}
    joint_pos: {func: 'isaaclab.envs.mdp.observations:joint_pos_rel', params: {}, scale: 1.0}
    joint_vel: {func: 'isaaclab.envs.mdp.observations:joint_vel_rel', params: {}, scale: null}
    actions: {func: 'isaaclab.envs.mdp.observations:last_action', params: {}}
    height_scan: null
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    joint_names: [.*]
    scale: 0.25
    use_default_offset: true
"""
BREADTH_FIRST = ("FL_hip", "FR_hip", "FL_calf", "FR_calf")


def network(inputs: int = 21) -> nn.Sequential:
    torch.manual_seed(2)
    return nn.Sequential(nn.Linear(inputs, 8), nn.ELU(), nn.Linear(8, 4), nn.ELU(), nn.Linear(4, 4))


@pytest.fixture
def run(tmp_path):
    """run(env.yaml, agent.yaml, network): a folder as these libraries leave it; its checkpoint."""

    def write(env: str, agent: str = "actor: {activation: elu}", net: nn.Sequential | None = None):
        net = net or network()
        (tmp_path / "params").mkdir(exist_ok=True)
        (tmp_path / "params/env.yaml").write_text(env)
        (tmp_path / "params/agent.yaml").write_text(agent)
        state = {f"mlp.{name}": value for name, value in net.state_dict().items()}
        state["distribution.std_param"] = torch.full((4,), 0.5)
        torch.save(
            {"actor_state_dict": state, "iter": 3, "infos": {"env_state": {"common_step_counter": 48}}},
            tmp_path / "model_3.pt",
        )
        return tmp_path / "model_3.pt"

    return write


def act(policy, observations: torch.Tensor) -> torch.Tensor:
    return Population.from_candidates(policy.card.sizes(), [policy.tensors]).mean(observations[None])[0].detach()


def targets(contract: Contract, names, action: torch.Tensor) -> dict[str, torch.Tensor]:
    """Joint name -> target, rad, as the source makes it of its own actions."""
    pose, scale = (
        torch.tensor(per_joint("", key, getattr(contract, key), names)) for key in ("default_pose", "action_scale")
    )
    return dict(zip(names, (pose + scale * action).T, strict=True))


def test_params_of_mjlab_say_all_but_the_joint_order(run):
    source = source_beside(run(MJLAB))
    contract = source.contract
    assert contract.missing() == ["joint_names"] and source.activation == "elu"
    assert contract.control_rate_hz == 50.0 and contract.delay_seconds == (0.0, 0.01)
    assert per_joint("", "default_pose", contract.default_pose, NAMES) == (0.1, -1.8, -0.1, -1.8)
    assert per_joint("", "action_scale", contract.action_scale, NAMES) == (0.3, 0.2, 0.3, 0.2)
    assert contract.said_by["kp"] == "params/env.yaml"
    with pytest.raises(PolicyError, match=r"says joint_names \(the source's joint order") as caught:
        import_whole(run(MJLAB), SPEC, strict=True)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("env", "names"), [(MJLAB, NAMES), (ISAAC, BREADTH_FIRST)])
def test_a_policy_of_mjlab_or_isaac_lab_sends_the_same_targets(run, env, names):
    net = network()
    imported = import_whole(run(env, net=net), SPEC, Layout((), names), strict=True)
    contract, policy = imported.contract, imported.policy
    torch.manual_seed(1)
    rate, gravity, command = torch.randn(3, 50, 3).unbind()
    q, dq, sent = (0.3 * torch.randn(3, 50, 4)).unbind()  # by SPEC's order; sent: the last targets, rad
    index = [NAMES.index(name) for name in names]
    pose, scale = (
        torch.tensor(per_joint("", key, getattr(contract, key), names)) for key in ("default_pose", "action_scale")
    )
    last = (sent[:, index] - pose) / scale
    if env is MJLAB:
        theirs = torch.cat((rate, gravity, q[:, index] - pose, 0.05 * dq[:, index], last, command), -1)
    else:
        theirs = torch.cat((0.25 * rate, gravity, command, q[:, index] - pose, dq[:, index], last), -1)
    wanted = targets(contract, names, net(theirs).detach())
    own, unit = torch.tensor(SPEC.default_pose), torch.tensor(SPEC.action_scale)
    ours = torch.cat((rate, gravity, command, q - own, dq, (sent - own) / unit), -1)
    found = own + unit * act(policy, ours)
    for column, name in enumerate(NAMES):
        torch.testing.assert_close(found[:, column], wanted[name], atol=1e-5, rtol=1e-5)
    assert policy.card.made["source"]["said_by"]["kd"] == "params/env.yaml"


def test_tags_of_python_name_nothing_and_run_nothing(run, tmp_path):
    evil = f"!!python/object/apply:os.system ['touch {tmp_path}/ran']"
    run(
        MJLAB.replace(
            "decimation: 4", f"decimation: 4\nviewer: {evil}\nmore: !!python/object/new:os.mkdir ['{tmp_path}/ran']"
        )
    )
    assert source_beside(tmp_path / "model_3.pt").contract.control_rate_hz == 50.0
    assert not (tmp_path / "ran").exists()


VELOCITY = "      base_lin_vel: {func: !!python/name:mjlab.envs.mdp.observations.base_lin_vel '', params: {}}\n"
SEES_VELOCITY = MJLAB.replace("    terms:\n", "    terms:\n" + VELOCITY)


def test_a_term_that_no_robot_measures_is_named_with_what_to_do(run):
    path = run(SEES_VELOCITY, net=network(24))
    with pytest.raises(
        PolicyError, match=r"observes 'base_lin_vel', the trunk's linear velocity.*Train it again without.*stand_in"
    ) as caught:
        import_whole(path, SPEC, Layout((), NAMES), strict=True)
    assert "\n" not in str(caught.value)


def test_a_layout_of_another_size_than_the_policy_is_what_is_to_be_corrected(run):
    parts = ({"name": "command", "size": 3}, {"name": "angular_velocity", "size": 3})
    with pytest.raises(
        PolicyError, match=r"takes 24 observations, the parts of the layout's `observation` have 6\. Add"
    ):
        import_whole(run(SEES_VELOCITY, net=network(24)), SPEC, Layout(parts, NAMES), strict=True)


@pytest.mark.parametrize("instead", [{"hold": 0.0}, {"stand_in": "command"}])
def test_a_constant_or_the_command_can_stand_in_for_the_velocity(run, instead):
    net = network(24)
    path = run(SEES_VELOCITY, net=net)
    contract = source_beside(path).contract
    parts = ({"name": "base_lin_vel", "size": 3, **instead}, *sized(source_beside(path).observation, 4)[1:])
    made = import_whole(path, SPEC, Layout(parts, NAMES), strict=True).policy
    torch.manual_seed(1)
    rate, gravity, command = torch.randn(3, 50, 3).unbind()
    q, dq, sent = (0.3 * torch.randn(3, 50, 4)).unbind()
    pose, scale = (
        torch.tensor(per_joint("", key, getattr(contract, key), NAMES)) for key in ("default_pose", "action_scale")
    )
    velocity = torch.zeros(50, 3) if "hold" in instead else command * torch.tensor([1.0, 1.0, 0.0])
    theirs = torch.cat((velocity, rate, gravity, q - pose, 0.05 * dq, (sent - pose) / scale, command), -1)
    own, unit = torch.tensor(SPEC.default_pose), torch.tensor(SPEC.action_scale)
    ours = torch.cat((rate, gravity, command, q - own, dq, (sent - own) / unit), -1)
    torch.testing.assert_close(own + unit * act(made, ours), pose + scale * net(theirs).detach(), atol=1e-5, rtol=1e-5)


CHANGES = {
    "its activation is tanh, hts computes ELU": (MJLAB, "actor: {activation: tanh}"),
    "is a JointEffortAction, expected a JointPositionAction": (
        ISAAC.replace("JointPositionAction", "JointEffortAction"),
        None,
    ),
    "has history": (MJLAB.replace("history_length: 0", "history_length: 3"), None),
    "is clipped at": (MJLAB.replace("scale: 0.05", "scale: 0.05, clip: [-2.0, 2.0]"), None),
    "asked 25 times a second, robot 'dog' asks 50": (MJLAB.replace("decimation: 4", "decimation: 8"), None),
    "not counted from the default pose": (MJLAB.replace("use_default_offset: true", "use_default_offset: false"), None),
    "clips targets": (MJLAB.replace("true\n    clip: null", "true\n    clip: {.*: [-1, 1]}"), None),
    "action_scale gives joint 'FR_calf' no number": (MJLAB.replace("0.3, .*_calf: 0.2", "0.3"), None),
    "'FR_calf' no number.*by the joint's name in the layout, or `rest: robot` there": (
        MJLAB.replace("0.3, .*_calf: 0.2", "0.3"),
        None,
    ),
    "default_pose .stated by params/env.yaml. of joint 'FR_calf' is -103 rad.*, and 1 more; in degrees": (
        MJLAB.replace(".*calf: -1.8", ".*calf: -103.0"),
        None,
    ),
    "has the pattern": (MJLAB.replace(".*calf: -1.8", "(.*)+calf: -1.8"), None),
    "only plain networks can be read": (MJLAB, "policy: {class_name: ActorCriticRecurrent}"),
    "not as mjlab or Isaac Lab writes it": ("decimation: 4", None),
    "cannot be read": ("a: [", None),
    "expected keys and values": ("- 1", None),
}


@pytest.mark.parametrize("words", CHANGES)
def test_what_cannot_be_followed_is_refused_in_one_line(run, words):
    env, agent = CHANGES[words]
    with pytest.raises(PolicyError, match=words) as caught:
        import_whole(run(env, agent or "actor: {activation: elu}"), SPEC, Layout((), NAMES), strict=True)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 600


def test_without_params_all_is_asked_for_at_once(run, tmp_path):
    path = run(MJLAB)
    for name in ("env.yaml", "agent.yaml"):
        (tmp_path / "params" / name).unlink()
    with pytest.raises(
        PolicyError, match=r"joint_names .*default_pose .*action_scale .*kp .*control_rate_hz .*delay_seconds"
    ):
        import_whole(path, SPEC, strict=True)


LAYOUT = """
joint_names: [FL_hip, FR_hip, FL_calf, FR_calf]
default_pose: {.*_hip: 0.05, .*_calf: -1.5}
action_scale: 0.25
delay_seconds: [0, 0.02]
rest: robot
observation:
  - {name: commands, size: 3, scale: 2.0}
  - {name: base_ang_vel, size: 3, scale: 0.25}
  - {name: projected_gravity, size: 3}
  - {name: dof_pos, size: 4}
  - {name: dof_vel, size: 4, scale: 0.05}
  - {name: actions, size: 4}
"""


def test_a_layout_states_what_legged_gym_does_not_write(run, tmp_path):
    path = run(MJLAB)
    (tmp_path / "params/env.yaml").unlink()
    (tmp_path / "layout.yaml").write_text(LAYOUT)
    layout = load_layout(tmp_path / "layout.yaml", SPEC)
    assert layout.contract.missing() == [] and layout.contract.said_by["kp"] == "the robot"
    made = import_whole(path, SPEC, layout, strict=True).policy.card.made
    assert made["proof"]["default_pose"] == {"state": "not proven", "why": "stated by layout.yaml; no log was replayed"}
    for wrong in ("delay_seconds: [0.02, 0]", "delay_seconds: 5", "rest: me", "action_scale: fast"):
        (tmp_path / "layout.yaml").write_text(
            LAYOUT.replace("delay_seconds: [0, 0.02]", wrong).replace("action_scale: 0.25\n", "")
        )
        with pytest.raises(ConfigError, match=r"layout.yaml"):
            load_layout(tmp_path / "layout.yaml", SPEC)


def test_no_value_that_a_robot_can_measure_meets_our_clip(run, tmp_path):
    """rsl_rl does not clip normalised observations; a term that hardly varied in training has a tiny spread there."""
    net = network()
    path = run(MJLAB, net=net)
    state = torch.load(path, weights_only=True)
    spread = torch.full((1, 21), 0.02)
    extra = {"_mean": 0.1 * torch.ones(1, 21), "_var": spread**2, "_std": spread, "count": torch.tensor(9)}
    state["actor_state_dict"] |= {f"obs_normalizer.{name}": value for name, value in extra.items()}
    torch.save(state, path)
    policy = import_whole(
        path, replace(SPEC, default_pose=(0.1, -1.8, -0.1, -1.8), action_scale=(0.3, 0.2, 0.3, 0.2)), Layout((), NAMES)
    ).policy
    command = torch.linspace(-REACH["command"], REACH["command"], 30)[:, None].expand(30, 3)
    zero = torch.zeros(30, 3)
    theirs = torch.cat((zero, zero, torch.zeros(30, 12), command), -1)
    ours = torch.cat((zero, zero, command, torch.zeros(30, 12)), -1)
    wanted = net((theirs - 0.1) / (spread + 0.01)).detach()
    torch.testing.assert_close(act(policy, ours), wanted, atol=1e-4, rtol=1e-5)
