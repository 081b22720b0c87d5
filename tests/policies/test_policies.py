"""Policy files and policies from elsewhere: round trips, damage, other robots, and code that must not run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import torch
from dog import SPEC
from safetensors.torch import save
from torch import nn

from hts.envs.observation import critic_observation_size, observation_layout
from hts.errors import PolicyError
from hts.policies.export import to_onnx, to_torchscript
from hts.policies.files import Policy, hash_tensors, load_policy, make_card, save_policy
from hts.policies.importing import Layout, import_policy
from hts.policies.proof import ITEMS, unproven
from hts.rl.population import Population, Sizes

SIZES = Sizes(15, critic_observation_size(2, 2), 2, (8, 4))  # 9 + 3 x 2


def population(seed: int = 0) -> Population:
    """One policy with a normaliser that is not trivial and an actor that acts."""
    made = Population(SIZES, 1, init_std=0.4, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        made.observation_mean += torch.randn(15, generator=generator)
        made.observation_std *= 0.5 + torch.rand(15, generator=generator)
        made.split(made.vectors[0])["actor.2.weight"].mul_(100.0)
    made.refresh()
    return made


def policy(seed: int = 0) -> Policy:
    tensors = population(seed).candidate(0)
    return Policy(tensors, make_card(SPEC, tensors, observation_layout(2), SIZES, command="by a test"))


def actions(made: Policy, observation: torch.Tensor) -> torch.Tensor:
    """Mean actions (batch, 2) of observations (batch, 15)."""
    return Population.from_candidates(made.card.sizes(), [made.tensors]).mean(observation[None])[0].detach()


@pytest.fixture
def saved(tmp_path):
    return save_policy(tmp_path / "walk", policy())


# -------------------------------------------------------------------------------------------------- files


def test_a_policy_survives_the_disk(saved):
    before, after = policy(), load_policy(saved, SPEC)
    assert after.card == dataclasses.replace(before.card, observation=after.card.observation)
    assert [dict(part) for part in after.card.observation] == observation_layout(2)
    assert all(torch.equal(before.tensors[name], after.tensors[name]) for name in before.tensors)
    assert sorted(path.name for path in saved.parent.iterdir()) == ["walk.json", "walk.safetensors"]


def test_a_name_with_dots_keeps_them(tmp_path):
    first = save_policy(tmp_path / "best-0.5", policy(0))
    second = save_policy(tmp_path / "best-0.2", policy(1))
    assert (first.name, second.name) == ("best-0.5.safetensors", "best-0.2.safetensors")
    assert load_policy(tmp_path / "best-0.5").card.policy_hash == policy(0).card.policy_hash


def test_policies_with_other_numbers_have_other_hashes():
    assert policy(0).card.policy_hash == policy(0).card.policy_hash != policy(1).card.policy_hash


def refusal(path, match: str, spec=SPEC) -> str:
    with pytest.raises(PolicyError, match=match) as caught:
        load_policy(path, spec)
    message = str(caught.value)
    assert str(path.with_suffix("")) in message
    return message


def test_a_missing_policy_is_one_line(tmp_path):
    refusal(tmp_path / "none.safetensors", "no such file")


def test_of_a_relative_path_that_is_not_there_is_said_from_where_it_counts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    message = refusal(Path("made/none.safetensors"), "made/none.json: no such file")
    assert f"counts from the folder where hts is typed, here {tmp_path}" in message and "config file" in message
    assert "counts from" not in refusal(tmp_path / "none.safetensors", "no such file")


@pytest.mark.parametrize("name", ["walk.onnx", "model_1500.pt", "walk.ts", "walk.ONNX"])
def test_a_policy_of_another_library_in_the_place_of_a_policy_file_is_told_how_it_comes_in(tmp_path, name):
    (tmp_path / name).write_bytes(b"as another library writes it")
    message = refusal(tmp_path / name, f"hts policy import {tmp_path / name} --robot {SPEC.name} --to ")
    assert "expected a .safetensors" in message and "no such file" not in message


def test_a_policy_file_with_such_an_ending_in_its_name_is_read(saved, tmp_path):
    for ending in (".safetensors", ".json"):
        saved.with_suffix(ending).rename(tmp_path / f"copy.onnx{ending}")
    (tmp_path / "copy.onnx").write_bytes(b"its export")
    assert load_policy(tmp_path / "copy.onnx", SPEC).tensors


def test_a_missing_card_is_one_line(saved):
    saved.with_suffix(".json").unlink()
    refusal(saved, "walk.json: no such file; a policy is a .safetensors and a .json")


@pytest.mark.parametrize("keep", [0, 5, 300, -1])
def test_a_truncated_file_is_one_line(saved, keep):
    saved.write_bytes(saved.read_bytes()[:keep])
    refusal(saved, "not a whole safetensors file")


def test_a_tampered_tensor_is_found(saved):
    data = bytearray(saved.read_bytes())
    data[-3] ^= 1
    saved.write_bytes(bytes(data))
    refusal(saved, "do not match the hash in walk.json")


@pytest.mark.parametrize("name", ["actor.1.weight", "critic.0.bias", "log_std", "observation_std", "stranger"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_numbers_that_are_not_finite_are_named_and_neither_written_read_nor_exported(tmp_path, name, bad):
    good = policy()
    tensors = {**good.tensors, "stranger": torch.zeros(2)}
    tensors[name] = torch.full_like(tensors[name], bad)
    broken = Policy(tensors, dataclasses.replace(good.card, policy_hash=hash_tensors(tensors)))
    path = tmp_path / "walk.safetensors"
    why = rf"walk\S*: '{name}' holds numbers that are not finite"
    for write in (save_policy, to_onnx, to_torchscript):
        with pytest.raises(PolicyError, match=why):
            write(path, broken) if write is save_policy else write(broken, tmp_path / "walk.onnx")
    assert not list(tmp_path.iterdir())
    path.write_bytes(save(tensors))  # by somebody else
    path.with_suffix(".json").write_text(json.dumps(dataclasses.asdict(broken.card)))
    for read in (load_policy, import_policy):
        with pytest.raises(PolicyError, match=why):
            read(path, SPEC)


def test_tensors_of_another_shape_are_named(saved):
    card = json.loads(saved.with_suffix(".json").read_text())
    saved.with_suffix(".json").write_text(json.dumps({**card, "hidden": [16, 4]}))
    refusal(saved, r"tensor 'actor.0.weight' has shape \(8, 15\), its card says \(16, 15\)")


def test_a_missing_normaliser_is_named(tmp_path):
    tensors = {name: value for name, value in policy().tensors.items() if name != "observation_std"}
    path = save_policy(tmp_path / "bare", Policy(tensors, make_card(SPEC, tensors, observation_layout(2), SIZES)))
    refusal(path, "tensor 'observation_std' is missing")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 1}', '{"format": 1, "colour": 3}'])
def test_a_damaged_card_is_one_line(saved, text):
    saved.with_suffix(".json").write_text(text)
    refusal(saved, "walk.json: (not a policy card|policy format None)")


def test_a_card_of_another_version_says_so(saved):
    saved.with_suffix(".json").write_text(saved.with_suffix(".json").read_text().replace('"format": 1', '"format": 2'))
    refusal(saved, "policy format 2, this version reads 1")


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"name": "cat"}, "made for robot dog, robot 'cat' has cat"),
        ({"joint_names": ("right", "left")}, "made for joint order"),
        ({"kp": (30.0, 30.0)}, "made for kp"),
        ({"control_rate_hz": 100.0}, "made for control rate 50.0"),
    ],
)
def test_a_policy_of_another_robot_is_refused(saved, changes, match):
    refusal(saved, match, dataclasses.replace(SPEC, **changes))


# ------------------------------------------------------------------------------------- import: ours, and onnx


def test_our_own_files_are_imported_as_they_are(saved):
    assert import_policy(saved, SPEC).card.policy_hash == policy().card.policy_hash


def test_an_exported_onnx_comes_back_with_the_same_actions(tmp_path):
    original, x = policy(), 3 * torch.randn(50, 15)
    back = import_policy(to_onnx(original, tmp_path / "walk.onnx"), SPEC, std=0.3)
    assert torch.equal(actions(back, x), actions(original, x))
    torch.testing.assert_close(back.tensors["log_std"].exp(), torch.full((2,), 0.3))
    assert back.card.made["imported_hash"] == original.card.policy_hash and back.card.made["critic"] == "new"
    # The new critic knows the scale of what both see.
    assert torch.equal(back.tensors["critic_observation_std"][:15], original.tensors["observation_std"])
    load_policy(save_policy(tmp_path / "again", back), SPEC)  # it is a whole policy


def test_an_onnx_of_another_robot_is_refused_and_without_its_card_it_is_anybodys(tmp_path):
    import onnx

    path = to_onnx(policy(), tmp_path / "walk.onnx")
    with pytest.raises(PolicyError, match="made for robot dog"):
        import_policy(path, dataclasses.replace(SPEC, name="cat"))
    model = onnx.load(str(path))
    del model.metadata_props[:]
    onnx.save(model, str(path))
    read = import_policy(path, SPEC)
    assert read.card.made["kind"] == "onnx" and unproven(read.card) == list(ITEMS)


def test_an_onnx_whose_graph_is_not_its_cards_is_refused(tmp_path):
    import onnx

    path = to_onnx(policy(), tmp_path / "walk.onnx")
    model = onnx.load(str(path))
    model.graph.node[4].op_type = "Relu"
    onnx.save(model, str(path))
    with pytest.raises(PolicyError, match="Sub-Div-Clip-Gemm-Relu-"):
        import_policy(path, SPEC)


def test_a_truncated_onnx_is_refused(tmp_path):
    path = to_onnx(policy(), tmp_path / "walk.onnx")
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(PolicyError, match="walk.onnx: not a whole ONNX file"):
        import_policy(path, SPEC)


# --------------------------------------------------------------------------------------------- import: rsl_rl


class Normalise(nn.Module):
    """What rsl_rl's EmpiricalNormalization computes: (x - mean) / (std + 0.01)."""

    def __init__(self, size: int):
        super().__init__()
        self.register_buffer("_mean", torch.randn(1, size))
        self.register_buffer("_var", torch.ones(1, size))
        self.register_buffer("_std", 0.5 + torch.rand(1, size))
        self.register_buffer("count", torch.tensor(1000))

    def forward(self, x):
        return (x - self._mean) / (self._std + 0.01)


def actor(inputs: int = 15, outputs: int = 2) -> nn.Sequential:
    torch.manual_seed(4)
    return nn.Sequential(nn.Linear(inputs, 8), nn.ELU(), nn.Linear(8, 4), nn.ELU(), nn.Linear(4, outputs))


def prefixed(prefix: str, module: nn.Module) -> dict[str, torch.Tensor]:
    return {f"{prefix}.{name}": value for name, value in module.state_dict().items()}


def checkpoint(kind: str, net: nn.Sequential, normalise: nn.Module) -> dict:
    """As rsl_rl of that generation saves it."""
    if kind == "plain":
        return {
            "model_state_dict": {"std": torch.full((2,), 0.3), **prefixed("actor", net)},
            "optimizer_state_dict": {},
            "iter": 300,
            "infos": None,
        }
    if kind == "beside":
        model = {"std": torch.full((2,), 0.3), **prefixed("actor", net), **prefixed("critic", actor(20, 1))}
        return {"model_state_dict": model, "iter": 300, "obs_norm_state_dict": normalise.state_dict()}
    if kind == "inside":
        model = {
            "log_std": torch.full((2,), 0.3).log(),
            **prefixed("actor", net),
            **prefixed("actor_obs_normalizer", normalise),
        }
        return {"model_state_dict": model, "iter": 300}
    model = {
        "distribution.std_param": torch.full((2,), 0.3),
        **prefixed("mlp", net),
        **prefixed("obs_normalizer", normalise),
    }
    return {"actor_state_dict": model, "critic_state_dict": {}, "iter": 300}


@pytest.mark.parametrize("kind", ["plain", "beside", "inside", "split"])
def test_an_rsl_rl_checkpoint_acts_as_it_did_there(tmp_path, kind):
    net, normalise, x = actor(), Normalise(15), torch.rand(50, 15) - 0.5
    torch.save(checkpoint(kind, net, normalise), tmp_path / "model.pt")
    made = import_policy(tmp_path / "model.pt", SPEC)
    expected = net(x) if kind == "plain" else net(normalise(x))
    torch.testing.assert_close(actions(made, x), expected.detach(), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(made.tensors["log_std"].exp(), torch.full((2,), 0.3))
    assert made.card.hidden == (8, 4) and made.card.made["iteration"] == 300 and made.card.robot == "dog"


def test_raw_observations_of_a_policy_without_normaliser_are_not_clipped_at_ten(tmp_path):
    net, x = actor(), torch.full((1, 15), 30.0)
    torch.save(checkpoint("plain", net, Normalise(15)), tmp_path / "model.pt")
    torch.testing.assert_close(actions(import_policy(tmp_path / "model.pt", SPEC), x), net(x).detach())


def test_a_checkpoint_with_scaled_observations_and_another_joint_order_is_translated(tmp_path):
    parts = [  # legged_gym's scales
        {"name": "command", "size": 3, "scale": 2.0},
        {"name": "angular_velocity", "size": 3, "scale": 0.25},
        {"name": "projected_gravity", "size": 3},
        {"name": "joint_position_offset", "size": 2},
        {"name": "joint_velocity", "size": 2, "scale": 0.05},
        {"name": "last_action", "size": 2},
    ]
    net, normalise, x = actor(), Normalise(15), torch.randn(20, 15)
    torch.save(checkpoint("inside", net, normalise), tmp_path / "model.pt")
    made = import_policy(tmp_path / "model.pt", SPEC, Layout(tuple(parts), joint_names=("right", "left")))
    rate, gravity, command, offset, speed, last = x.split([3, 3, 3, 2, 2, 2], -1)
    theirs = torch.cat((2 * command, 0.25 * rate, gravity, offset.flip(-1), 0.05 * speed.flip(-1), last.flip(-1)), -1)
    expected = net(normalise(theirs)).flip(-1).detach()
    torch.testing.assert_close(actions(made, x), expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: {}, r"has the parts \[\], expected 'model_state_dict'"),
        (
            lambda c: {"model_state_dict": {**c["model_state_dict"], "memory_a.rnn.weight": torch.ones(2)}},
            "memory_a.rnn.weight",
        ),
        (
            lambda c: {"model_state_dict": prefixed("actor", actor(16))},
            "maps 16 observations to 2 actions, expected 15 to 2",
        ),
        (lambda c: {**c, "obs_norm_state_dict": {"mean": torch.ones(15)}}, "expected '_mean' and '_std'"),
        (lambda c: {**c, "obs_norm_state_dict": Normalise(14).state_dict()}, "its normaliser has 14 entries"),
        (lambda c: {"model_state_dict": {"actor.0.weight": torch.ones(2, 15)}}, "expected linear layers 0, 2, 4"),
        (
            lambda c: {
                "model_state_dict": prefixed("actor", actor()) | {"actor.4.bias": torch.tensor([1.0, float("inf")])}
            },
            "not finite",
        ),
    ],
)
def test_a_checkpoint_that_is_not_understood_is_refused_with_what_was_found(tmp_path, change, match):
    path = tmp_path / "model.pt"
    torch.save(change(checkpoint("plain", actor(), Normalise(15))), path)
    with pytest.raises(PolicyError, match=match) as caught:
        import_policy(path, SPEC)
    assert str(caught.value).startswith(f"{path}: ")


class Trap:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_a_checkpoint_that_would_run_code_is_refused_and_runs_none(tmp_path):
    torch.save({"model_state_dict": Trap(tmp_path / "ran")}, tmp_path / "model.pt")
    with pytest.raises(
        PolicyError, match="weights only .it holds Python objects such as .*open, which would have to be run"
    ):
        import_policy(tmp_path / "model.pt", SPEC)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("name", ["walk.pt", "walk.jit", "walk.torchscript"])
def test_torchscript_is_refused_because_loading_it_runs_it(tmp_path, name):
    to_torchscript(policy(), tmp_path / name)
    with pytest.raises(PolicyError, match="TorchScript file. That is a program, and loading it would run it"):
        import_policy(tmp_path / name, SPEC)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 broken", b"not a checkpoint"])
def test_a_damaged_checkpoint_is_one_line(tmp_path, content):
    (tmp_path / "model.pt").write_bytes(content)
    with pytest.raises(PolicyError, match="model.pt: cannot be read as weights only") as caught:
        import_policy(tmp_path / "model.pt", SPEC)
    assert "\n" not in str(caught.value)


def test_an_unknown_kind_of_file_lists_those_that_can_be_read(tmp_path):
    with pytest.raises(PolicyError, match=r"\.safetensors .*\.onnx and \.pt"):
        import_policy(tmp_path / "walk.h5", SPEC)


def test_a_missing_file_is_one_line(tmp_path):
    for name in ("walk.pt", "walk.onnx", "walk.safetensors"):
        with pytest.raises(PolicyError, match=name.replace("safetensors", "json")):
            import_policy(tmp_path / name, SPEC)
