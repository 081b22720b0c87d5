"""What a world gets is the policy that the run means: its ONNX file is compared with the policy before each trial."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import onnx
import pytest

from hts import api
from hts.errors import PolicyError
from hts.evaluation.evaluate import policy_file
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy
from hts.policies.onnx_ours import what_differs

CANDIDATE = "iterations/00/candidates/00-00"


def forget(folder: Path, *stages: str) -> None:
    """As if the run had been stopped before these stages. The report stays."""
    for stage in (*stages, "final", "summary"):
        (folder / f"{stage}.json").unlink()


def tried(folder: Path) -> str:
    (name,) = json.loads((folder / "iterations/00/test.json").read_text())["elites"]
    return f"iterations/00/candidates/{name}"


def flip(path: Path) -> None:
    """One bit in the midst of it, which is a weight."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def swap(path: Path) -> None:
    shutil.copy(path.with_name("00-01.onnx" if path.stem == "00-00" else "00-00.onnx"), path)


@pytest.mark.parametrize(
    ("which", "harm", "said"),
    [
        ("elite", swap, "it holds policy "),
        ("elite", truncate, "not a whole ONNX file"),
        ("policies/pretrained", flip, "its constant 'weight"),
    ],
)
def test_another_policy_does_not_walk_and_what_is_said_mends_it(kit_run, broken_kit_run, which, harm, said):
    path = broken_kit_run / f"{tried(broken_kit_run) if which == 'elite' else which}.onnx"
    whole = path.read_bytes()
    forget(broken_kit_run, "iterations/00/test")
    harm(path)
    with pytest.raises(PolicyError) as caught:
        api.resume(broken_kit_run)
    line = str(caught.value)
    assert line.startswith(f"{path}: damaged, or of another policy ({said}") and "\n" not in line
    assert line.endswith(f"Delete it and `hts resume {broken_kit_run}` writes it again.")
    path.unlink()
    api.resume(broken_kit_run)
    assert path.read_bytes() == whole
    assert kit_run.summary_of(broken_kit_run) == kit_run.summary_of()


@pytest.mark.parametrize("stage", ["collect", "final"])
def test_the_reference_of_first_data_and_of_the_final_is_looked_at_too(broken_kit_run, stage):
    forget(broken_kit_run, *(["collect"] if stage == "collect" else []))
    flip(broken_kit_run / "policies/pretrained.onnx")
    with pytest.raises(PolicyError, match=r"pretrained\.onnx: damaged, or of another policy"):
        api.resume(broken_kit_run)


def test_a_missing_file_is_written_again_and_said(kit_run, broken_kit_run, capsys):
    path = broken_kit_run / f"{tried(broken_kit_run)}.onnx"
    whole = path.read_bytes()
    forget(broken_kit_run, "iterations/00/test")
    path.unlink()
    api.resume(broken_kit_run)
    assert f"{path}: is missing, so it is written again from {path.stem}.safetensors." in capsys.readouterr().out
    assert path.read_bytes() == whole
    assert kit_run.summary_of(broken_kit_run) == kit_run.summary_of()


@pytest.mark.parametrize("content", ["{", "[]", "{}", None])
def test_the_note_of_the_best_is_what_the_gate_found_whatever_became_of_the_candidates(broken_kit_run, content):
    path, note = broken_kit_run / f"{tried(broken_kit_run)}.gate.json", broken_kit_run / "policies/best.gate.json"
    whole = note.read_bytes()
    assert whole == path.read_bytes()
    forget(broken_kit_run)
    note.unlink()
    path.unlink() if content is None else path.write_text(content)
    api.resume(broken_kit_run)
    assert note.read_bytes() == whole


def rewritten(path: Path, change) -> None:
    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())


def test_what_an_earlier_version_wrote_of_a_policy_is_that_policy(broken_kit_run):
    path, policy = broken_kit_run / f"{CANDIDATE}.onnx", load_policy(broken_kit_run / CANDIDATE)

    def fewer(model):
        card = next(entry.value for entry in model.metadata_props if entry.key == "hts")
        onnx.helper.set_model_props(model, {"hts": card})
        model.producer_name = "earlier"

    rewritten(path, fewer)
    assert what_differs(path, policy) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda policy: {"kp": tuple(2 * one for one in policy.card.kp)}, "its card is another one"),
        (lambda policy: {"policy_hash": "0" * 64}, "it holds policy 000000000000"),
    ],
)
def test_another_card_is_another_policy(broken_kit_run, change, said):
    policy = load_policy(broken_kit_run / CANDIDATE)
    path = to_onnx(Policy(policy.tensors, replace(policy.card, **change(policy))), broken_kit_run / f"{CANDIDATE}.onnx")
    assert what_differs(path, policy) == said


def test_other_metadata_are_another_policy_but_for_what_is_computed_when_exporting(broken_kit_run):
    path, policy = broken_kit_run / f"{CANDIDATE}.onnx", load_policy(broken_kit_run / CANDIDATE)

    def changed(key):
        def change(model):
            next(entry for entry in model.metadata_props if entry.key == key).value = "1.0"

        return change

    rewritten(path, changed("action_sigma"))
    assert what_differs(path, policy) is None
    rewritten(path, changed("joint_stiffness"))
    assert what_differs(path, policy) == "its metadata say another joint_stiffness"


@pytest.mark.parametrize("content", [b"", b"\xff", b"no policy"])
def test_a_file_that_is_no_policy_is_said_to_be_none(broken_kit_run, content):
    path = broken_kit_run / f"{CANDIDATE}.onnx"
    path.write_bytes(content)
    assert (what_differs(path, load_policy(broken_kit_run / CANDIDATE)) or "").startswith("not a whole ONNX file")


def test_evaluating_compares_them_too_and_exports_again_what_was_deleted(broken_kit_run):
    path = broken_kit_run / "policies/pretrained.onnx"
    whole = path.read_bytes()
    flip(path)
    with pytest.raises(PolicyError, match=rf"^{path}: damaged, or of another policy .* Delete it and give the command"):
        policy_file(broken_kit_run, "pretrained")
    with pytest.raises(PolicyError, match=rf"^{path}: damaged"):
        policy_file(broken_kit_run, path)
    path.unlink()
    assert policy_file(broken_kit_run, "pretrained").read_bytes() == whole


def test_a_graph_that_computes_something_else_is_another_policy(broken_kit_run):
    path, policy = broken_kit_run / f"{CANDIDATE}.onnx", load_policy(broken_kit_run / CANDIDATE)
    rewritten(path, lambda model: setattr(model.graph.node[4], "op_type", "Relu"))
    assert (what_differs(path, policy) or "").startswith("its graph is Sub-Div-Clip-Gemm-Relu")
