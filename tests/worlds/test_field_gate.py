"""A verdict of the gate goes with the policy: whoever it refused is not bundled under another name either."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
from field_folder import bundle, field

from hts.cli.main import main
from hts.errors import PolicyError, RunError, WaitingForRobot, WorldError
from hts.policies.deploy import DeployedPolicy
from hts.policies.export_command import export_policy
from hts.policies.files import Policy, hash_tensors, load_policy, save_policy
from hts.policies.gate_notes import note_of
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.gated import vouched_for

REFUSED = '{"passed": false, "refused": "00-00 is refused by the gate: the trunk tilts by 31 degrees (allowed: 25)"}'


def test_a_policy_that_the_gate_refused_is_not_bundled_unless_the_run_lets_a_machine_have_it(run, policy):
    policy.with_suffix(".gate.json").write_text(REFUSED)
    refused = r"walk.onnx: 00-00 is refused by the gate: .*\(allowed: 25\)\. It is not bundled.*gate\.strict=false"
    for strict in ("", "gate: {strict: null}\n", "gate: {strict: true}\n"):
        (run / "config.yaml").write_text(f"preset: smoke\n{strict}")
        with pytest.raises(WorldError, match=refused) as caught:
            field(run).head_to_head(policy, policy, [0.8])
        assert "\n" not in str(caught.value)
        assert not list(run.rglob("policies"))  # nor half of it
    (run / "config.yaml").write_text("gate: {strict: false}\n")
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    assert json.loads((bundle(run) / "manifest.json").read_text())["policies"][0]["gate"]["passed"] is False


def test_a_policy_of_which_nobody_can_read_what_the_gate_found_is_not_bundled(run, policy):
    policy.with_suffix(".gate.json").write_text(REFUSED[:20])
    with pytest.raises(
        WorldError, match=r"walk.gate.json: cannot be read as JSON .*whether the gate refused its policy"
    ):
        field(run).head_to_head(policy, policy, [0.8])


@pytest.fixture
def refused(run, robot) -> Path:
    """The candidate 00-00 of a run, whom its gate refused."""
    file = save_policy(run / "iterations" / "00" / "candidates" / "00-00", load_policy(robot.pretrained_policy()))
    note = {**json.loads(REFUSED), "policy_hash": load_policy(file).card.policy_hash}
    file.with_suffix(".gate.json").write_text(json.dumps(note))
    return file


@pytest.mark.parametrize("held", [False, True], ids=["as it is", "with commands of held speeds"])
def test_a_refused_policy_is_not_bundled_under_another_name(run, refused, policy, held, tmp_path):
    """`policy` holds the same parameters as the candidate, with no note beside it."""
    from hts.policies.export import to_onnx
    from hts.policies.held_commands import HeldCommands

    other = to_onnx(load_policy(refused), tmp_path / "x.onnx", HeldCommands((0.5,), (0.6,)) if held else None)
    with pytest.raises(WorldError, match=r"x.onnx: 00-00 is refused by the gate: .* It is not bundled"):
        field(run).head_to_head(other, other, [0.8])


def test_a_note_that_keeps_somebody_out_and_says_not_whom_is_known_by_the_card_beside_it(run, refused, policy):
    refused.with_suffix(".gate.json").write_text(REFUSED)  # as earlier versions wrote it
    with pytest.raises(WorldError, match=r"walk.onnx: 00-00 is refused by the gate"):
        field(run).head_to_head(policy, policy, [0.8])


@pytest.mark.parametrize(
    ("whose", "said"),
    [({"policy_hash": "a" * 64}, "is of policy aaaaaaaaaaaa…"), ({}, "does not say of which policy it is")],
)
def test_a_note_of_another_policy_is_not_believed(run, policy, whose, said):
    policy.with_suffix(".gate.json").write_text(json.dumps({"passed": True, **whose}))
    with pytest.raises(WorldError, match=rf"walk.gate.json: {said}, but walk.onnx is .*Move the file away") as caught:
        field(run).head_to_head(policy, policy, [0.8])
    assert "\n" not in str(caught.value)


def test_a_stopped_training_is_said_of_its_candidate_and_not_of_the_anchor_that_it_holds_again(run, policy, refused):
    """`policy` has the same parameters, as the anchor of a candidate that was stopped has."""
    from hts.policies.export import to_onnx

    refused.with_suffix(".gate.json").write_text(json.dumps({**json.loads(REFUSED), "failed": ["training stopped"]}))
    candidate = to_onnx(load_policy(refused), refused.with_suffix(".onnx"))
    with pytest.raises(WorldError, match=r"00-00 is refused by the gate"):
        field(run).head_to_head(candidate, policy, [0.8])
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])


@pytest.fixture
def tuned(robot) -> Policy:
    """A candidate of some run."""
    policy = load_policy(robot.pretrained_policy())
    tensors = {name: 1.01 * value for name, value in policy.tensors.items()}
    made = {"anchor": policy.card.policy_hash, "iteration": 0}
    return Policy(tensors, dataclasses.replace(policy.card, policy_hash=hash_tensors(tensors), made=made))


@pytest.fixture
def fine_tuned(tuned, tmp_path) -> Path:
    """Its ONNX file alone."""
    from hts.policies.export import to_onnx

    return to_onnx(tuned, tmp_path / "carried.onnx")


def test_a_candidate_of_another_run_that_came_without_its_note_is_not_bundled(run, policy, fine_tuned):
    said = (
        r"carried.onnx: carried was fine-tuned in another run, and what the gate found .* is not known here: "
        r"carried.gate.json, .* did not come along, or it was never tried\. It is not bundled for a machine: "
        r"put carried.gate.json beside the policy that you named\."
    )
    with pytest.raises(WorldError, match=said) as caught:
        field(run).head_to_head(fine_tuned, policy, [0.8])
    assert "\n" not in str(caught.value)
    assert not list(run.rglob("policies"))
    whose = DeployedPolicy(fine_tuned).card.policy_hash
    fine_tuned.with_suffix(".gate.json").write_text(json.dumps({"passed": True, "policy_hash": whose}))
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(fine_tuned, policy, [0.8])


def test_a_run_that_lets_a_machine_have_who_fails_bundles_it_for_a_person_to_vouch_for(run, policy, fine_tuned):
    (run / "config.yaml").write_text("gate: {strict: false}\n")
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(fine_tuned, policy, [0.8])
    gates = {one["file"]: one["gate"] for one in json.loads((bundle(run) / "manifest.json").read_text())["policies"]}
    assert gates["policies/00-walk.onnx"] is None
    assert (gates["policies/01-carried.onnx"]["passed"], gates["policies/01-carried.onnx"]["failed"]) == (
        False,
        ["not known"],
    )
    loaded = load_bundle(bundle(run))  # the runtime believes it, and asks
    with pytest.raises(RuntimeFault, match=r"01-carried.onnx failed the gate .*not known here.* --vouch"):
        vouched_for(loaded.policies, loaded.policies, ())


def test_a_candidate_of_the_run_itself_that_nobody_tried_is_bundled_as_not_tried(run, policy, tuned, fine_tuned):
    save_policy(run / "iterations" / "00" / "candidates" / "00-01", tuned)
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(fine_tuned, policy, [0.8])
    assert all(one["gate"] is None for one in json.loads((bundle(run) / "manifest.json").read_text())["policies"])


def test_a_note_that_does_not_say_whether_it_passed_is_refused(run, policy):
    policy.with_suffix(".gate.json").write_text('{"passed": "no"}')
    with pytest.raises(WorldError, match=r"walk.gate.json: found .*expected `passed` true or false"):
        field(run).head_to_head(policy, policy, [0.8])


def test_an_export_takes_along_what_the_gate_found_and_says_that_it_refused(run, refused, tmp_path, capsys):
    target = tmp_path / "out" / "x.onnx"
    assert main(["export", str(run), "--policy", "00-00", "--to", str(target)]) == 0
    assert "00-00 is refused by the gate: the trunk tilts by 31 degrees" in " ".join(capsys.readouterr().err.split())
    assert json.loads(target.with_suffix(".gate.json").read_text()) == json.loads(
        refused.with_suffix(".gate.json").read_text()
    )
    refused.with_suffix(".gate.json").unlink()
    with pytest.raises(WorldError, match="x.onnx: 00-00 is refused by the gate"):
        field(run).head_to_head(target, target, [0.8])


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("00-01", "its run keeps no finding of a gate about it"),  # the run trained it; its gate never tried it
        ("carried.safetensors", "a run fine-tuned it, and what its gate found of it was not known"),
        ("imported.safetensors", "no run fine-tuned it, and no finding of a gate about it is known"),
    ],
)
def test_an_export_of_a_policy_that_no_gate_tried_says_so(run, robot, tuned, tmp_path, capsys, name, why):
    save_policy(run / "iterations" / "00" / "candidates" / "00-01", tuned)
    save_policy(tmp_path / "carried", tuned)
    save_policy(tmp_path / "imported", load_policy(robot.pretrained_policy()))
    target, is_file = tmp_path / "out" / "x.onnx", name.endswith(".safetensors")
    given = ["--policy", str(tmp_path / name)] if is_file else [str(run), "--policy", name]
    assert main(["export", *given, "--to", str(target)]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert f"x.onnx: as far as is known, this policy has not been through the gate ({why}" in said
    note = json.loads(target.with_suffix(".gate.json").read_text())
    assert note["passed"] is None
    assert note["untried"].startswith(why)
    assert note["policy_hash"] == DeployedPolicy(target).card.policy_hash


def test_an_export_of_a_policy_that_passed_says_nothing(run, refused, tmp_path, capsys):
    note = {"passed": True, "policy_hash": load_policy(refused).card.policy_hash}
    refused.with_suffix(".gate.json").write_text(json.dumps(note))
    assert main(["export", str(run), "--policy", "00-00", "--to", str(tmp_path / "x.onnx")]) == 0
    assert capsys.readouterr().err == ""


def test_a_note_that_says_untried_is_none_of_the_gate(run, policy, fine_tuned, robot):
    """It refuses nobody, stands behind what a run found, and of a fine-tuned policy of another run nothing is known."""

    def untried(onnx: Path) -> None:
        note = {"passed": None, "untried": "no gate was asked", "policy_hash": DeployedPolicy(onnx).card.policy_hash}
        onnx.with_suffix(".gate.json").write_text(json.dumps(note))

    untried(policy)
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    (only,) = json.loads((bundle(run) / "manifest.json").read_text())["policies"]
    assert only["gate"] is None
    assert "**No gate is known to have tried** `policies/00-walk.onnx`." in (bundle(run) / "README.md").read_text()
    untried(fine_tuned)
    with pytest.raises(
        WorldError, match=r"carried.gate.json says that no gate was asked\..*: export it from the folder"
    ):
        field(run).head_to_head(fine_tuned, policy, [0.8])
    save_policy(run / "iterations" / "00" / "candidates" / "00-00", load_policy(robot.pretrained_policy()))
    (run / "iterations" / "00" / "candidates" / "00-00.gate.json").write_text(REFUSED)
    with pytest.raises(WorldError, match=r"walk.onnx: 00-00 is refused by the gate"):
        field(run).head_to_head(policy, policy, [0.9])


def test_a_bundle_says_who_failed_the_gate_and_who_passed(run, policy):
    (run / "config.yaml").write_text("gate: {strict: false}\n")
    own = {"policy_hash": DeployedPolicy(policy).card.policy_hash}
    policy.with_suffix(".gate.json").write_text(json.dumps({"passed": True, **own}))
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    assert "- All policies of this bundle passed it." in (bundle(run) / "README.md").read_text()
    shutil.rmtree(bundle(run))
    policy.with_suffix(".gate.json").write_text(REFUSED)
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    assert "`policies/00-walk.onnx` **failed the gate**: 00-00 is refused" in (bundle(run) / "README.md").read_text()


def test_a_copied_policy_file_of_a_run_is_known_too(run, refused, tmp_path):
    for suffix in (".safetensors", ".json"):
        shutil.copyfile(refused.with_suffix(suffix), tmp_path / f"mine{suffix}")
    export_policy(run, str(tmp_path / "mine.safetensors"), "onnx", tmp_path / "y.onnx")
    assert json.loads((tmp_path / "y.gate.json").read_text())["passed"] is False


def test_an_export_is_not_written_beside_what_the_gate_found_of_another_policy(run, refused, tmp_path):
    target = tmp_path / "x.onnx"
    target.with_suffix(".gate.json").write_text('{"passed": true}')
    with pytest.raises(RunError, match=r"x.gate.json: exists already, and tells of another policy"):
        export_policy(run, "00-00", "onnx", target)
    assert not target.exists()


def test_of_two_notes_the_one_that_refuses_counts(run, refused, tmp_path):
    card = {"policy_hash": json.loads(refused.with_suffix(".gate.json").read_text())["policy_hash"]}
    (tmp_path / "x.gate.json").write_text(json.dumps({"passed": True, **card}))
    assert note_of(tmp_path / "x.onnx", card, run)["passed"] is False
    assert note_of(tmp_path / "x.onnx", card)["passed"] is True
    assert note_of(tmp_path / "y.onnx", {"policy_hash": "f" * 64}, run) is None
    refused.with_suffix(".gate.json").write_text("{")
    with pytest.raises(PolicyError, match=r"00-00.gate.json: cannot be read as JSON"):
        note_of(tmp_path / "x.onnx", card, run)
