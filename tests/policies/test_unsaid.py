"""What a checkpoint of rsl_rl and the files beside it leave unsaid, or say in a way that would pass for another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from dog import FOUR as SPEC
from torch import nn

from hts.errors import PolicyError
from hts.policies.contract import Contract
from hts.policies.importing import import_whole
from hts.policies.layout import Layout, load_layout
from hts.policies.params import source_beside
from hts.policies.replay import replay
from hts.policies.replay_log import Log

NAMES = SPEC.joint_names
STATED = Contract(NAMES, SPEC.default_pose, SPEC.action_scale, SPEC.kp, SPEC.kd, 50.0, (0.0, 0.0))
SIZES = {"base_ang_vel": 3, "projected_gravity": 3, "commands": 3, "dof_pos": 4, "dof_vel": 4, "actions": 4}
PARTS = tuple({"name": name, "size": size} for name, size in SIZES.items())

ISAAC = """
sim: {dt: 0.005}
decimation: 4
scene:
  robot:
    init_state: {joint_pos: {.*_hip: 0.0, .*_calf: -1.8}}
    actuators: {legs: {joint_names_expr: [.*], stiffness: 20.0, damping: 0.5}}
observations:
  policy:
    concatenate_terms: true
    base_ang_vel: {func: 'isaaclab.envs.mdp.observations:base_ang_vel', params: {}}
    projected_gravity: {func: 'isaaclab.envs.mdp.observations:projected_gravity', params: {}, modifiers: null}
  joints:
    joint_pos:
      func: isaaclab.envs.mdp.observations:joint_pos_rel
      params: {asset_cfg: {name: robot, joint_names: SEEN, preserve_order: KEPT}}
    joint_vel:
      func: isaaclab.envs.mdp.observations:joint_vel_rel
      params: {asset_cfg: {name: robot, joint_names: SEEN, preserve_order: KEPT}}
    actions: {func: 'isaaclab.envs.mdp.observations:last_action', params: {}}
    velocity_commands: {func: 'isaaclab.envs.mdp.observations:generated_commands', params: {}}
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    joint_names: [FL_hip, FR_hip, FL_calf, FR_calf]
    preserve_order: true
    scale: 0.25
    use_default_offset: true
"""
AGENT = "actor: {activation: elu}\nobs_groups: {actor: [policy, joints], critic: [policy]}\n"
OTHER = ("FL_hip", "FR_hip", "FL_calf", "FR_calf")


def checkpoint(folder, inputs: int = 21, outputs: int = 4, sigma: bool = True):
    torch.manual_seed(0)
    net = nn.Sequential(nn.Linear(inputs, 8), nn.ELU(), nn.Linear(8, outputs))
    state = {f"mlp.{name}": value for name, value in net.state_dict().items()}
    if sigma:
        state["distribution.std_param"] = torch.full((outputs,), 0.3)
    path = folder / "model_3.pt"
    torch.save({"actor_state_dict": state, "iter": 3}, path)
    return path


def isaac(folder, seen: str = "[FL_hip, FR_hip, FL_calf, FR_calf]", kept: str = "true", agent: str = AGENT):
    (folder / "params").mkdir()
    (folder / "params/env.yaml").write_text(ISAAC.replace("SEEN", seen).replace("KEPT", kept))
    (folder / "params/agent.yaml").write_text(agent)
    return checkpoint(folder)


def test_what_a_policy_observes_is_asked_for_like_the_rest(tmp_path):
    path = checkpoint(tmp_path)
    with pytest.raises(PolicyError, match=r"says observation \(its parts in its order, with their scales\)") as caught:
        import_whole(path, SPEC, Layout((), NAMES, STATED), strict=True)
    assert "\n" not in str(caught.value)
    import_whole(path, SPEC, Layout(PARTS, NAMES, STATED), strict=True)
    (tmp_path / "layout.yaml").write_text("rest: robot\ndelay_seconds: 0\n")
    import_whole(path, SPEC, load_layout(tmp_path / "layout.yaml", SPEC), strict=True)


def test_joints_in_an_order_of_their_own_are_read_where_all_terms_keep_it(tmp_path):
    found = source_beside(isaac(tmp_path))
    assert found.contract.joint_names == OTHER and found.contract.said_by["joint_names"] == "params/env.yaml"


@pytest.mark.parametrize(
    ("seen", "kept"), [(".*", "false"), ("[FR_hip, FL_hip, FR_calf, FL_calf]", "true"), (str(list(OTHER)), "false")]
)
def test_actions_and_observations_in_different_orders_of_joints_are_refused(tmp_path, seen, kept):
    with pytest.raises(PolicyError, match=r"its action has the joints in the order FL_hip.*'joint_pos' in") as caught:
        import_whole(isaac(tmp_path, seen, kept), SPEC, Layout((), OTHER, STATED), strict=True)
    assert "\n" not in str(caught.value)


def test_the_groups_that_rsl_rl_gives_the_actor_follow_one_another(tmp_path):
    names = [part["name"] for part in source_beside(isaac(tmp_path)).observation]
    assert names == [
        "angular_velocity",
        "projected_gravity",
        "joint_position_offset",
        "joint_velocity",
        "last_action",
        "command",
    ]


def test_a_group_that_the_file_does_not_describe_is_asked_for(tmp_path):
    path = isaac(tmp_path, agent=AGENT.replace("[policy, joints]", "[policy, camera]"))
    with pytest.raises(PolicyError, match="says observation"):
        import_whole(path, SPEC, Layout((), None, replace(STATED, joint_names=None)), strict=True)


def test_an_observation_that_goes_through_modifiers_is_refused(tmp_path):
    path = isaac(tmp_path)
    file = tmp_path / "params/env.yaml"
    file.write_text(file.read_text().replace("modifiers: null", "modifiers: [{func: 'isaaclab.utils.modifiers:bias'}]"))
    with pytest.raises(PolicyError, match="'projected_gravity' goes through modifiers, which hts does not compute"):
        source_beside(path)


def test_an_activation_that_nothing_states_is_said_to_be_taken_for_elu(tmp_path):
    told = import_whole(checkpoint(tmp_path), SPEC, Layout(PARTS, NAMES, STATED)).policy.card.made["proof"]["actions"]
    assert "nothing says its activation, taken to be ELU" in told["why"]
    read = import_whole(isaac(tmp_path), SPEC, Layout((), OTHER, STATED)).policy.card.made["proof"]["actions"]
    assert "activation" not in read["why"]


def test_a_sigma_that_depends_on_the_state_is_named(tmp_path):
    path = checkpoint(tmp_path, outputs=8, sigma=False)
    with pytest.raises(PolicyError, match=r"gives 8 numbers for 4 joints: with a sigma that depends on what it sees"):
        import_whole(path, SPEC, Layout(PARTS, NAMES, STATED))


def test_a_history_is_told_to_be_trained_again_and_not_to_be_added_to_the_layout(tmp_path):
    with pytest.raises(PolicyError, match=r"takes 105 .*105 = 5 x 21: a history.*Train it again with one") as caught:
        import_whole(checkpoint(tmp_path, inputs=105), SPEC, Layout(PARTS, NAMES, STATED))
    assert "Add the parts" not in str(caught.value)


def test_a_part_that_the_task_has_not_is_told_what_can_be_done(tmp_path):
    parts = (*PARTS, {"name": "clock_inputs", "size": 4})
    with pytest.raises(PolicyError, match=r"'clock_inputs'.*Train it again without.*hold") as caught:
        import_whole(checkpoint(tmp_path, inputs=25), SPEC, Layout(parts, NAMES, STATED))
    assert "\n" not in str(caught.value)


def test_torques_that_were_computed_with_their_targets_are_told_from_measured_ones(tmp_path):
    imported = import_whole(checkpoint(tmp_path), SPEC, Layout(PARTS, NAMES, STATED))
    state = torch.load(tmp_path / "model_3.pt", weights_only=True)["actor_state_dict"]
    net = nn.Sequential(nn.Linear(21, 8), nn.ELU(), nn.Linear(8, 4))
    net.load_state_dict({name.removeprefix("mlp."): value for name, value in state.items() if "mlp" in name})
    torch.manual_seed(1)
    seen, actions = torch.randn(300, 21), torch.zeros(300, 4)
    for row in range(300):
        seen[row, 17:] = actions[row - 1]  # the last one
        actions[row] = net(seen[row]).detach()
    given, pose = seen.double().numpy(), np.array(SPEC.default_pose)
    target, position, velocity = pose + 0.25 * actions.double().numpy(), given[:, 9:13] + pose, given[:, 13:17]
    torque = 20.0 * (target - position) - 0.5 * velocity
    joints = {"joint_target": target, "joint_position": position, "joint_velocity": velocity, "joint_torque": torque}
    vectors = {"angular_velocity": given[:, :3], "projected_gravity": given[:, 3:6], "command": given[:, 6:9]}
    stamps = np.arange(300) / 50.0
    log = Log(tmp_path / "walk.npz", stamps, NAMES, given, actions.double().numpy(), joints, vectors)
    found = replay(tmp_path / "model_3.pt", imported, log, SPEC)
    assert found["gains"].state == "proven"
    assert "computed then, not measured with the state" in found["delay"].why
