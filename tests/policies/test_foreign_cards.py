"""Cards and ONNX graphs that somebody else wrote: what cannot drive a robot is refused in one line, before it runs."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import onnx
import pytest
from dog import UNEVEN as SPEC
from onnx import TensorProto, helper, numpy_helper

from hts.errors import PolicyError
from hts.policies.card_checks import check_card
from hts.policies.deploy import CARD_KEY, DeployedPolicy
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy, make_card, save_policy
from hts.policies.importing import import_policy
from hts.rl.population import Population, Sizes

SIZES = Sizes(4, 6, 2, (8,))


@pytest.fixture
def policy() -> Policy:
    tensors = Population(SIZES, 1, seed=0).candidate(0)
    return Policy(
        tensors, make_card(SPEC, tensors, [{"name": "command", "size": 3}, {"name": "tilt", "size": 1}], SIZES)
    )


@pytest.fixture
def exported(policy, tmp_path) -> Path:
    return to_onnx(policy, tmp_path / "walk.onnx")


WRONG = {
    "kp": [[20.0, math.nan], [20.0, math.inf], [20.0, -1.0], [20.0], [20.0, 1e9], [20.0, "20"], [20.0, True], 20.0],
    "default_pose": [[0.1, math.nan], [0.1, 0.2, 0.3]],
    "action_scale": [[0.25, -math.inf], None],
    "joint_names": [["left", "left"], [], "left", [1, 2]],
    "control_rate_hz": [0, -50, math.nan, "50", None],
    "observation": [
        [],
        {},
        [{"name": "command"}],
        [{"name": "command", "size": 0}],
        [{"name": "c", "size": 10**12}],
        [3],
    ],
    "history": [0, 10**9, 1.5],
    "hidden": [[10**9], [0], [16] * 100, 16],
    "exploration_std": [[0.1], [0.1, math.nan], [-0.1, 0.1]],
    "critic_observation_size": [0, 10**12, None],
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in WRONG.items() for value in values])
def test_a_card_that_cannot_be_is_refused_by_its_key(policy, tmp_path, key, value):
    path = save_policy(tmp_path / "walk", policy)
    card = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps({**card, key: value}))
    with pytest.raises(
        PolicyError, match=f"walk.json: its card says .*{key.split('_size')[0]}|an observation"
    ) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_our_own_cards_pass(policy):
    card = {**vars(policy.card), "exploration_std": (0.1, 0.2)}
    check_card(card, Path("walk.json"))
    check_card({key: value for key, value in card.items() if key not in ("history", "hidden")}, Path("walk.json"))


def test_the_card_inside_an_exported_policy_is_checked_too(exported):
    model = onnx.load(exported)
    (entry,) = [entry for entry in model.metadata_props if entry.key == CARD_KEY]
    entry.value = json.dumps({**json.loads(entry.value), "kp": [20.0, 1e30]})
    onnx.save(model, exported)
    with pytest.raises(PolicyError, match=r"walk.onnx: its card says kp 1e\+30 of 'right'"):
        DeployedPolicy(exported)


def another_input(model):
    model.graph.input.append(helper.make_tensor_value_info("secret", TensorProto.FLOAT, [1]))
    model.graph.node.append(helper.make_node("Identity", ["secret"], ["shown"]))


def another_output(model):
    model.graph.node.append(helper.make_node("Identity", ["observation"], ["copy"]))
    model.graph.output.append(helper.make_tensor_value_info("copy", TensorProto.FLOAT, ["batch", 4]))


def narrower_input(model):
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 3


def external_data(model):
    (mean,) = [tensor for tensor in model.graph.initializer if tensor.name == "mean"]
    mean.ClearField("raw_data")
    mean.data_location = TensorProto.EXTERNAL
    mean.external_data.add(key="location", value="../secret.bin")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            another_input,
            r"its graph reads observation .*, secret .*its card says observation \(tensor\(float\), 4 wide\)",
        ),
        (another_output, "its graph gives action .*, copy "),
        (narrower_input, "its graph reads observation .* 3 wide|not an exported policy"),
        (external_data, "its constant 'mean' lies in another file"),
    ],
)
def test_a_graph_with_other_ends_is_not_run(exported, change, words):
    (exported.parent.parent / "secret.bin").write_bytes(np.zeros(4, np.float32).tobytes())
    model = onnx.load(exported)
    change(model)
    exported.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyError, match=f"walk.onnx: .*({words})") as caught:
        DeployedPolicy(exported)
    assert "\n" not in str(caught.value)


def transposed(model):
    node = next(node for node in model.graph.node if node.op_type == "Gemm")
    node.attribute.append(helper.make_attribute("alpha", 2.0))


def swapped(model):
    node = next(node for node in model.graph.node if node.op_type == "Sub")
    node.input[:] = ["mean", "observation"]


def foreign_domain(model):
    next(node for node in model.graph.node if node.op_type == "Elu").domain = "somebody"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (another_input, "its graph is Sub-Div-Clip"),
        (external_data, "its constant 'mean' lies in another file"),
        (transposed, "its Gemm of h0, weight0, bias0 is not that of an exported policy"),
        (swapped, "its Sub of mean, observation is not that"),
        (foreign_domain, "its graph has the operator 'somebody.Elu', which no policy needs"),
    ],
)
def test_a_graph_that_computes_something_else_is_not_imported(exported, change, words):
    model = onnx.load(exported)
    change(model)
    exported.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyError, match=f"walk.onnx: {words}"):
        import_policy(exported, SPEC)


def test_an_exported_policy_is_imported(exported, policy):
    again = import_policy(exported, SPEC)
    weight = numpy_helper.to_array(onnx.load(exported).graph.initializer[2])
    assert np.array_equal(again.tensors["actor.0.weight"].numpy(), weight)
