"""Actors of other libraries: what their examples prove, what is refused, the lines of the manual."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn
from torch.nn import functional as F

from hts.contracts import LogOnlyRobot, Robot
from hts.errors import ConfigError, PolicyError
from hts.policies.importing import import_policy
from hts.policies.layers import holds_layers
from hts.policies.layout import Layout, load_layout, seen_by, seen_in_velocity_task
from hts.rl.population import Population
from hts.testing.examples.robot.robot import SPEC, Tiny

PAGE = Path(__file__).resolve().parents[2] / "docs/policies-from-elsewhere.md"
PARTS = [
    {"name": "command", "size": 3, "scale": 2.0},
    {"name": "angular_velocity", "size": 3, "scale": 0.25},
    {"name": "projected_gravity", "size": 3},
    {"name": "joint_position_offset", "size": 2},
    {"name": "joint_velocity", "size": 2, "scale": 0.05},
    {"name": "last_action", "size": 2},
]


def a_network(activation: type[nn.Module] = nn.ELU, outputs: int = 2) -> nn.Sequential:
    torch.manual_seed(3)
    return nn.Sequential(nn.Linear(15, 8), activation(), nn.Linear(8, 4), activation(), nn.Linear(4, outputs))


def a_file(
    net: nn.Sequential, actions=lambda net, x: net(x), **changes: torch.Tensor | None
) -> dict[str, torch.Tensor]:
    """What somebody writes at home; changes: other tensors, None to leave one out."""
    torch.manual_seed(4)
    observation = 2 * torch.randn(40, 15)
    linear = [one for one in net if isinstance(one, nn.Linear)]
    tensors = {f"layer.{i}.{what}": getattr(one, what) for i, one in enumerate(linear) for what in ("weight", "bias")}
    tensors |= {"example_observation": observation, "example_action": actions(net, observation)}
    given = {**tensors, **changes}
    return {name: value.detach().clone().contiguous() for name, value in given.items() if value is not None}


@pytest.fixture
def written(tmp_path):
    """written(net, …): path of the file of a network, see `a_file`."""

    def write(*given, **changes) -> Path:
        save_file(a_file(*given, **changes), tmp_path / "actor.safetensors")
        return tmp_path / "actor.safetensors"

    return write


def actions(policy, observations: torch.Tensor) -> torch.Tensor:
    return Population.from_candidates(policy.card.sizes(), [policy.tensors]).mean(observations[None])[0]


# ------------------------------------------------------------------------------------------------------- what is read


def test_layers_alone_act_as_the_original(written):
    net, x = a_network(), torch.randn(30, 15)
    made = import_policy(written(net), SPEC)
    torch.testing.assert_close(actions(made, x), net(x).detach(), atol=1e-5, rtol=1e-5)
    assert (made.card.robot, made.card.hidden, made.card.made["replayed"]) == ("tiny", (8, 4), 40)
    torch.testing.assert_close(made.tensors["log_std"].exp(), torch.full((2,), 0.2))


@pytest.mark.parametrize("clip", [None, 1.5, 10.0, 30.0])
def test_a_normaliser_and_its_clip_come_along(written, clip):
    net, mean, std = a_network(), torch.arange(15) / 5, 0.5 + torch.arange(15) / 10

    def normalised(x: torch.Tensor) -> torch.Tensor:
        z = (x - mean) / std
        return z if clip is None else z.clamp(-clip, clip)

    changes = {"mean": mean, "std": std, "clip": None if clip is None else torch.tensor(clip)}
    made = import_policy(written(net, lambda net, x: net(normalised(x)), **changes), SPEC)
    x = 4 * torch.randn(200, 15)
    torch.testing.assert_close(actions(made, x), net(normalised(x)).detach(), atol=1e-5, rtol=1e-5)


def test_another_order_other_scales_and_other_joints_are_translated(written):
    net = a_network()
    made = import_policy(
        written(net, log_std=torch.tensor([-1.0, -2.0])), SPEC, Layout(tuple(PARTS), joint_names=("right", "left"))
    )
    x = torch.randn(30, 15)
    rate, gravity, command, offset, speed, last = x.split([3, 3, 3, 2, 2, 2], -1)
    theirs = torch.cat((2 * command, 0.25 * rate, gravity, offset.flip(-1), 0.05 * speed.flip(-1), last.flip(-1)), -1)
    torch.testing.assert_close(actions(made, x), net(theirs).flip(-1).detach(), atol=1e-5, rtol=1e-5)
    assert made.tensors["log_std"].tolist() == [-2.0, -1.0]


def test_of_means_and_sigmas_the_means_count(written):
    net, x = a_network(outputs=4), torch.randn(30, 15)
    made = import_policy(written(net, lambda net, x: net(x)[:, :2]), SPEC)
    torch.testing.assert_close(actions(made, x), net(x)[:, :2].detach(), atol=1e-5, rtol=1e-5)


def test_a_robot_with_an_env_of_its_own_says_what_is_seen_there(written):
    class Own(Robot):
        spec = SPEC
        mjcf = channels = pretrained_policy = None

        def make_env(self, *given, **named):
            return Tiny().make_env(*given, **named)

    assert seen_by(Own()) == seen_by(Tiny()) == seen_in_velocity_task(SPEC)
    with pytest.raises(ConfigError, match="has no env to train in"):
        seen_by(LogOnlyRobot(SPEC, []))


# ---------------------------------------------------------------------------------------------------- what is refused


def squashed(net: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    return net(x).tanh()


def clipped(net: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    return net(x).clamp(-0.25, 0.25)


@pytest.mark.parametrize(
    ("net", "given", "expected"),
    [
        (a_network(nn.Tanh), lambda net, x: net(x), "its activation is Tanh, hts computes ELU"),
        (a_network(nn.ReLU), lambda net, x: net(x), "its activation is ReLU"),
        (a_network(), squashed, "squashes actions by tanh"),
        (a_network(), clipped, "the original clips actions at 0.25"),
        (a_network(), lambda net, x: net(x) + 3e-5, "off by up to 3e-05. Check the order"),
        (a_network(), lambda net, x: net(x).flip(-1), "are not those of its examples"),
    ],
)
def test_an_original_that_acts_otherwise_is_refused_with_the_reason(written, net, given, expected):
    path = written(net, given)
    with pytest.raises(PolicyError) as refused:
        import_policy(path, SPEC)
    assert str(refused.value).startswith(f"{path}: ") and expected in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"example_action": None}, r"example_action have the shapes \(40, 15\) and \(0,\), expected \(n, 15\)"),
        ({"example_action": torch.zeros(40, 2)}, "all its examples have one action"),
        ({"layer.1.bias": None}, "expected layer.0, layer.1, … with weight and bias each"),
        ({"layer.1.weight": torch.ones(4, 9)}, r"layer 1 has the shapes \(4, 9\) and \(4,\), which do not fit"),
        ({"mean": torch.zeros(3)}, r"mean and std have the shapes \(3,\)"),
        ({"std": torch.zeros(15)}, "std above 0"),
        ({"clip": torch.tensor(-1.0)}, "clip is -1"),
        ({"layer.0.bias": torch.full((8,), float("nan"))}, "'layer.0.bias' holds what are no finite numbers"),
        ({"log_std": torch.tensor([1, 2])}, "'log_std' holds what are no finite numbers"),
        ({"log_std": torch.zeros(5)}, "'log_std' has 5 numbers for 2 joints"),
        ({"layer.2.weight": torch.ones(7, 4), "layer.2.bias": torch.ones(7)}, "map 15 observations to 7 actions"),
    ],
)
def test_a_file_that_is_not_whole_is_one_line(written, changes, expected):
    path = written(a_network(), **changes)
    with pytest.raises(PolicyError, match=expected) as refused:
        import_policy(path, SPEC)
    assert "\n" not in str(refused.value)


def test_other_files_are_not_taken_for_layers(tmp_path):
    save_file({"x": torch.ones(1)}, tmp_path / "other.safetensors")
    (tmp_path / "text.safetensors").write_text("no")
    for name in ("other", "text", "none"):
        assert not holds_layers(tmp_path / f"{name}.safetensors")


def test_a_layout_is_yaml_and_its_mistakes_are_named(tmp_path):
    (text,) = re.findall(r'```yaml title="layout.yaml"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    file = tmp_path / "layout.yaml"
    file.write_text(text)
    layout = load_layout(file)
    assert [part["scale"] for part in layout.observation] == [2.0, 0.25, 1.0, 1.0, 0.05, 1.0]
    assert layout.joint_names == ("right", "left")
    for wrong, expected in (("size: 3", "sizes: 3"), ("scale: 0.25", "scale: 0")):
        file.write_text(text.replace(wrong, expected))
        with pytest.raises(ConfigError, match=r"layout.yaml: observation"):
            load_layout(file)


# ----------------------------------------------------------------------------------------- the command and the manual


def test_the_command_writes_a_policy_and_nothing_over_another(written, tmp_path, hts_here):
    from hts.policies.files import load_policy
    from hts.testing.packages import kit_installed

    file = written(a_network())
    with kit_installed():
        bare = ("policy", "import", file, "--robot", "tiny", "--to", tmp_path / "mine.safetensors")
        guessed = hts_here(*bare)  # its order, pose and scale are nowhere: never taken for the robot's without a word
        assert guessed.returncode == 2 and "neither it nor what lies beside it says joint_names" in guessed.stderr
        (tmp_path / "layout.yaml").write_text("rest: robot\ndelay_seconds: 0\n")
        words = (*bare[:3], "--layout", tmp_path / "layout.yaml", *bare[3:])
        done = hts_here(*words)
        assert done.returncode == 0, done.stderr
        assert "15-8-4-2 for robot tiny, 40 actions replayed, off by at most" in done.stdout
        assert load_policy(tmp_path / "mine.safetensors", SPEC).card.made["kind"] == "layers"
        again = hts_here(*words)
        assert again.returncode == 2 and "mine.safetensors: exists already" in again.stderr
        renamed = hts_here(*words[:-1], tmp_path / "mine.onnx", "--no-trial")
        assert renamed.returncode == 2 and "mine.onnx: expected a name that ends in .safetensors" in renamed.stderr
        assert not list(tmp_path.glob("mine.onnx*"))


def block(title: str, after: str = "") -> str:
    text = PAGE.read_text()
    return re.findall(rf"{re.escape(after)}```python{re.escape(title)}\n(.*?)```", text, re.DOTALL)[0]


def test_the_lines_for_stable_baselines3_bring_its_policy(tmp_path):
    """In a process of its own: what it imports warns of other things than hts."""
    if importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed; hts does not need it (docs/policies-from-elsewhere.md)")
    (tmp_path / "from_sb3.py").write_text(block(' title="from_sb3.py"'))
    mark = "<!-- run by tests/policies/test_layers.py::test_the_lines_for_stable_baselines3_bring_its_policy -->\n"
    code = block("", after=mark) + (
        "seen = envs.normalize_obs(observations)\n"
        "np.save('expected.npy', model.policy.get_distribution(model.policy.obs_to_tensor(seen)[0]).mode().detach())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={**os.environ}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    written = load_file(tmp_path / "actor.safetensors")
    made = import_policy(tmp_path / "actor.safetensors", SPEC)
    found = actions(made, written["example_observation"])
    expected = torch.from_numpy(np.load(tmp_path / "expected.npy"))
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
    assert float(F.mse_loss(expected, expected.mean(0).expand_as(expected))) > 1e-6  # it does something
    assert float(written["clip"]) == 10.0 and made.card.made["largest_difference"] < 1e-5
