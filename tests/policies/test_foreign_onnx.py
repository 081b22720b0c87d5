"""ONNX files that others exported: plain networks are read, whatever else they hold is refused, nothing is run."""

from __future__ import annotations

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from dog import SPEC
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from hts.errors import PolicyError
from hts.policies.deploy import DeployedPolicy
from hts.policies.importing import import_policy, import_whole
from hts.policies.layout import Layout
from hts.policies.onnx_checks import read_checked
from hts.policies.onnx_layers import network_of
from hts.rl.population import Population

MJLABS = {  # the metadata that mjlab 1.6 writes, for two joints
    "joint_names": "right,left",
    "joint_stiffness": "20.000,20.000",
    "joint_damping": "0.500,0.500",
    "default_joint_pos": "-0.100,0.100",
    "observation_names": "base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command",
    "observation_terms_scale": "1.000,1.000,1.000,1.000,1.000,1.000",
    "observation_terms_history_length": "0.000,0.000,0.000,0.000,0.000,0.000",
    "action_scale": "0.250,0.250",
}
RNG = np.random.default_rng(3)
WEIGHTS = [0.4 * RNG.standard_normal(shape).astype(np.float32) for shape in ((8, 15), (4, 8), (2, 4))]
BIASES = [0.4 * RNG.standard_normal(len(weight)).astype(np.float32) for weight in WEIGHTS]
MEAN, STD = RNG.standard_normal(15).astype(np.float32), 0.5 + RNG.random(15).astype(np.float32)


def graph(nodes, path, constants=(), meta=None, width=15, ends=("obs", "actions")):
    held = {f"w{i}": w for i, w in enumerate(WEIGHTS)} | {f"b{i}": b for i, b in enumerate(BIASES)}
    held |= {f"t{i}": np.ascontiguousarray(w.T) for i, w in enumerate(WEIGHTS)} | {"mean": MEAN, "std": STD}
    held |= dict(constants)
    used = {name for node in nodes for name in node.input}
    made = helper.make_graph(
        list(nodes),
        "policy",
        [helper.make_tensor_value_info(ends[0], TensorProto.FLOAT, [1, width])],
        [helper.make_tensor_value_info(ends[1], TensorProto.FLOAT, [1, 2])],
        [numpy_helper.from_array(value, name) for name, value in held.items() if name in used],
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    helper.set_model_props(model, meta or {})
    path.write_bytes(model.SerializeToString())
    return path


def node(kind, given, gives, **attributes):
    return helper.make_node(kind, given.split(), gives.split(), **attributes)


def gemms(first="n", activation="Elu"):
    """As torch's exporter writes them."""
    return [
        node("Gemm", f"{first} w0 b0", "h0", transB=1),
        node(activation, "h0", "e0"),
        node("Gemm", "e0 w1 b1", "h1", transB=1),
        node(activation, "h1", "e1"),
        node("Gemm", "e1 w2 b2", "actions", transB=1),
    ]


NORMALISED = [node("Sub", "obs mean", "c"), node("Div", "c std", "n")]
MATMULS = [
    node("Sub", "obs mean", "c"),
    node("Mul", "c inverse", "n"),
    node("MatMul", "n t0", "m0"),
    node("Add", "b0 m0", "h0"),
    node("Elu", "h0", "e0", alpha=1.0),
    node("MatMul", "e0 t1", "m1"),
    node("Add", "m1 b1", "h1"),
    node("Elu", "h1", "e1"),
    node("MatMul", "e1 t2", "m2"),
    node("Add", "m2 b2", "i"),
    node("Identity", "i", "actions"),
]
FOLDS = [
    node("Constant", "", "eps", value=numpy_helper.from_array(np.float32(0.25))),
    node("Sub", "std eps", "less"),
    node("Add", "less eps", "spread"),
    node("Sub", "mean obs", "c"),
    node("Neg", "spread", "minus"),
    node("Div", "c minus", "n"),
    *gemms(),
]
READ = {"as mjlab writes it": [*NORMALISED, *gemms()], "matrix products": MATMULS, "folded": FOLDS}


@pytest.mark.parametrize("kind", READ)
def test_a_plain_network_gives_the_actions_that_its_graph_gives(tmp_path, kind):
    path = graph(READ[kind], tmp_path / "policy.onnx", {"inverse": 1 / STD})
    network = network_of(path, read_checked(path))
    x = (2 * RNG.standard_normal((60, 15))).astype(np.float32)
    session = onnxruntime.InferenceSession(str(path))
    wanted = np.concatenate([session.run(None, {"obs": row[None]})[0] for row in x])
    made = import_policy(path, SPEC)
    found = Population.from_candidates(made.card.sizes(), [made.tensors]).mean(torch.from_numpy(x)[None])[0]
    np.testing.assert_allclose(found.detach().numpy(), wanted, atol=1e-5, rtol=1e-5)
    assert network.clip is None and len(network.layers) == 3


def test_metadata_of_mjlab_say_order_and_meaning_and_the_rest_is_asked_for(tmp_path):
    path = graph([*NORMALISED, *gemms()], tmp_path / "policy.onnx", meta=MJLABS)
    with pytest.raises(PolicyError, match=r"says control_rate_hz .*; delay_seconds .*State them in a layout"):
        import_whole(path, SPEC, strict=True)
    imported = import_whole(path, SPEC)
    assert imported.contract.joint_names == ("right", "left")
    x = RNG.standard_normal((30, 15)).astype(np.float32)  # ours: rate, gravity, command, offset, speed, last action
    rate, gravity, command, offset, speed, last = np.split(x, [3, 6, 9, 11, 13], axis=1)
    theirs = np.concatenate([rate, gravity, offset[:, ::-1], speed[:, ::-1], last[:, ::-1], command], 1)
    session = onnxruntime.InferenceSession(str(path))
    wanted = np.concatenate([session.run(None, {"obs": row[None]})[0] for row in theirs])[:, ::-1]
    policy = imported.policy
    found = Population.from_candidates(policy.card.sizes(), [policy.tensors]).mean(torch.from_numpy(x)[None])[0]
    np.testing.assert_allclose(found.detach().numpy(), wanted, atol=1e-5, rtol=1e-5)


def brax():
    """As the notebook of mujoco_playground writes it: swish, means and sigmas, tanh."""
    return [
        *NORMALISED,
        node("MatMul", "n t0", "m0"),
        node("Add", "m0 b0", "h0"),
        node("Sigmoid", "h0", "s0"),
        node("Mul", "h0 s0", "e0"),
        node("MatMul", "e0 t1", "m1"),
        node("Add", "m1 b1", "h1"),
        node("Sigmoid", "h1", "s1"),
        node("Mul", "h1 s1", "e1"),
        node("MatMul", "e1 t2", "m2"),
        node("Tanh", "m2", "actions"),
    ]


def cut(values):
    return [*NORMALISED, *gemms()[:-1], node("Gemm", "e1 w2 b2", "both", transB=1), *values]


LOOP = helper.make_graph([node("Identity", "obs", "actions")], "inner", [], [])
REFUSED = {
    "activation Swish": brax(),
    "activation Relu, hts computes ELU": [*NORMALISED, *gemms(activation="Relu")],
    "activation Tanh, hts computes ELU": cut([node("Tanh", "both", "actions")]),
    "ELU with alpha 0.5": [*NORMALISED, *gemms()[:1], node("Elu", "h0", "e0", alpha=0.5), *gemms()[2:]],
    "keeps numbers between -1 and 1": cut([node("Clip", "both low high", "actions")]),
    "takes a part of what its network gives": cut([node("Slice", "both from to", "actions")]),
    "no activation between": [*gemms("obs")[:1], node("Gemm", "h0 w1 b1", "h1", transB=1), *gemms()[3:]],
    "the operator 'Loop', which no policy needs": [node("Loop", " ", "actions", body=LOOP)],
    "the operator 'evil.Elu'": [*NORMALISED, helper.make_node("Elu", ["n"], ["actions"], domain="evil")],
    "divides into": [*NORMALISED, *gemms(), node("Elu", "n", "x")],
    "not one line": [*NORMALISED, node("Add", "x y", "z"), *gemms()],
    "unfolds a constant": [node("Add", "column row", "mean2"), node("Sub", "obs mean2", "n"), *gemms()],
    "does not say how many": None,
}


@pytest.mark.parametrize("words", REFUSED)
def test_another_graph_is_refused_in_one_line(tmp_path, words):
    constants = {"low": np.float32(-1), "high": np.float32(1), "from": np.array([0]), "to": np.array([2])}
    constants |= {"column": np.zeros((300, 1), np.float32), "row": np.zeros((1, 300), np.float32)}
    nodes = REFUSED[words] or gemms("obs")
    path = graph(nodes, tmp_path / "policy.onnx", constants, width=None if REFUSED[words] is None else 15)
    for read in (lambda: import_policy(path, SPEC), lambda: DeployedPolicy(path)):
        with pytest.raises(PolicyError) as caught:
            read()
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
    with pytest.raises(PolicyError, match=words):
        import_policy(path, SPEC)


def test_constants_in_another_file_are_never_opened(tmp_path):
    path = graph([*NORMALISED, *gemms()], tmp_path / "policy.onnx")
    onnx.save(onnx.load(path), path, save_as_external_data=True, location="secret.bin", size_threshold=0)
    assert (tmp_path / "secret.bin").exists()
    with pytest.raises(PolicyError, match=r"lies in another file.*external_data=False"):
        import_policy(path, SPEC)


# ------------------------------------------------------------------------------------------------------------ fuzzing

FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def one_line_or_right(read):
    """Whatever a file holds: it is read, or refused by one printable line."""
    try:
        read()
    except PolicyError as error:
        text = str(error)
        assert "\n" not in text and len(text) < 700 and text.isprintable(), text


@FUZZ
@given(data=st.data())
def test_a_mutated_onnx_file_is_read_or_refused_in_one_line(tmp_path, data):
    path = graph([*NORMALISED, *gemms()], tmp_path / "policy.onnx", meta=MJLABS)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))]))
    one_line_or_right(lambda: import_policy(path, SPEC))


@FUZZ
@given(meta=st.dictionaries(st.sampled_from([*MJLABS, "control_dt", "action_delay_seconds"]), st.text(max_size=60)))
def test_metadata_of_any_kind_are_read_or_refused_in_one_line(tmp_path, meta):
    plain = {key: value.encode("utf-8", "ignore").decode() for key, value in meta.items()}
    path = graph([*NORMALISED, *gemms()], tmp_path / "policy.onnx", meta={**MJLABS, **plain})
    one_line_or_right(lambda: import_policy(path, SPEC))


LEAVES = st.one_of(
    st.none(),
    st.integers(-5, 5),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(0, 3), max_size=3),
    st.builds(lambda *size: torch.ones(*size), st.integers(0, 20), st.integers(0, 20)),
    st.just(torch.ones(())),
    st.just(torch.full((15,), float("nan"))),
    st.just(torch.ones(8, dtype=torch.bool)),
)
KEYS = (
    "mlp.0.weight",
    "mlp.0.bias",
    "mlp.2.weight",
    "mlp.2.bias",
    "distribution.std_param",
    "obs_normalizer._mean",
    "obs_normalizer._std",
    "log_std",
    "mlp.1.weight",
    "other",
)


OUTER = ("iter", "infos", "model_state_dict", "actor_state_dict", "obs_norm_state_dict")


@FUZZ
@given(
    changes=st.dictionaries(st.sampled_from(KEYS), LEAVES, max_size=4),
    outer=st.dictionaries(st.sampled_from(OUTER), LEAVES, max_size=2),
)
def test_a_checkpoint_with_any_parts_is_read_or_refused_in_one_line(tmp_path, changes, outer):
    net = nn.Sequential(nn.Linear(15, 8), nn.ELU(), nn.Linear(8, 2))
    state = {f"mlp.{name}": value for name, value in net.state_dict().items()}
    torch.save({"actor_state_dict": {**state, **changes}, "iter": 1, **outer}, tmp_path / "model.pt")
    one_line_or_right(lambda: import_policy(tmp_path / "model.pt", SPEC, Layout(())))


@FUZZ
@given(data=st.data())
def test_a_mutated_checkpoint_is_read_or_refused_in_one_line(tmp_path, data):
    net = nn.Sequential(nn.Linear(15, 8), nn.ELU(), nn.Linear(8, 2))
    state = {f"mlp.{name}": value for name, value in net.state_dict().items()}
    torch.save({"actor_state_dict": state, "iter": 1}, tmp_path / "model.pt")
    content = bytearray((tmp_path / "model.pt").read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "model.pt").write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))]))
    one_line_or_right(lambda: import_policy(tmp_path / "model.pt", SPEC))
