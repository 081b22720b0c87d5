"""Exported policies with the commands of a final in front: what is wanted goes in, what was sent comes out."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from dog import UNEVEN as SPEC

from hts.cli.main import main
from hts.envs.observation import observation_layout
from hts.errors import PolicyError
from hts.policies.deploy import DeployedPolicy
from hts.policies.export import to_onnx, to_torchscript
from hts.policies.export_checks import check_export, random_observations
from hts.policies.export_command import export_policy
from hts.policies.files import Policy, make_card, save_policy
from hts.policies.held_commands import HeldCommands, columns, has_held_commands, held_commands_of
from hts.rl.population import Population, Sizes

FOUND = HeldCommands((0.5, 0.8, 1.1), (0.43, 0.9, 1.25))
VX = 6  # of the observation: after the angular velocity and the direction of gravity


def made(history: int = 1) -> Policy:
    sizes = Sizes(15 * history, 21, 2, (16, 8))
    population = Population(sizes, 1, seed=3)
    with torch.no_grad():
        population.split(population.vectors[0])["actor.2.weight"].mul_(100.0)
    tensors = population.candidate(0)
    return Policy(tensors, dataclasses.replace(make_card(SPEC, tensors, observation_layout(2), sizes), history=history))


def actions(policy: Policy, observations: np.ndarray) -> np.ndarray:
    """The policy's own, of what it sees."""
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
    return population.mean(torch.from_numpy(observations)[None])[0].detach().numpy()


def run_folder(folder: Path, policy: Policy, **final) -> Path:
    """What a finished run leaves, as far as an export reads it."""
    (folder / "policies").mkdir(parents=True)
    (folder / "config.yaml").write_text("preset: smoke\n")
    for name in ("best", "pretrained"):
        save_policy(folder / "policies" / name, policy)
    rows = {
        str(speed): {"held": True, "commanded": command, "reference": {"commanded": speed + 0.01}}
        for speed, command in zip(FOUND.speeds, FOUND.commands, strict=True)
    }
    said = {"policy": "02-01", "objectives": {"cost": {"speeds": rows}}, **final}
    (folder / "summary.json").write_text(json.dumps({"final": said if "policy" in said else None}))
    return folder


@pytest.mark.parametrize(
    ("wanted", "sent"),
    [(0.0, 0.0), (0.25, 0.215), (0.5, 0.43), (0.65, 0.665), (1.1, 1.25), (2.0, 1.25), (-0.3, -0.3)],
    ids=["standing", "slower", "the slowest", "between", "the fastest", "faster", "backwards"],
)
def test_a_wanted_speed_becomes_the_command_that_was_sent_for_it(wanted, sent):
    assert FOUND.of(np.array(wanted)) == pytest.approx(sent)


def test_the_pieces_are_the_same_function():
    speeds = np.random.default_rng(0).uniform(-1.0, 2.0, 1000)
    pieces = zip(*FOUND.pieces(), strict=True)
    bent = speeds + sum(change * np.clip(speeds - start, 0.0, width) for start, width, change in pieces)
    np.testing.assert_allclose(bent, FOUND.of(speeds), atol=1e-12)


def test_steep_maps_are_exported_too(tmp_path):
    """Far from any command, where random observations reach, large terms must not be left to cancel."""
    steep = HeldCommands((0.3, 0.31, 0.9, 1.0), (0.2, 0.6, 0.65, 1.4))
    policy = made()
    for seed in range(20):
        given = [random_observations(policy, seed)]
        assert check_export(policy, to_onnx(policy, tmp_path / "p.onnx", steep), "onnx", given, steep) < 1e-5


@pytest.mark.parametrize("place", [0, VX, VX + 1])
def test_an_infinite_reading_is_clipped_as_ever(tmp_path, place):
    policy, given = made(), np.zeros((1, 15), np.float32)
    given[0, place] = np.inf
    session = onnxruntime.InferenceSession(str(to_onnx(policy, tmp_path / "p.onnx", FOUND)))
    assert np.isfinite(session.run(["action"], {"observation": given})[0]).all()
    traced = torch.jit.load(str(to_torchscript(policy, tmp_path / "p.ts", FOUND)))
    assert torch.isfinite(traced(torch.from_numpy(given))).all()


def test_whether_a_file_has_them_is_read_from_it(tmp_path):
    assert has_held_commands(to_onnx(made(), tmp_path / "p.onnx", FOUND))
    assert not has_held_commands(to_onnx(made(), tmp_path / "q.onnx"))
    assert not has_held_commands(tmp_path / "best")


def test_it_is_another_policy_and_says_whose(tmp_path):
    policy = made()
    card = DeployedPolicy(to_onnx(policy, tmp_path / "p.onnx", FOUND)).card
    assert card.policy_hash != policy.card.policy_hash == card.made["held"]["policy_hash"]
    other = DeployedPolicy(to_onnx(policy, tmp_path / "q.onnx", HeldCommands((0.5,), (0.4,)))).card
    assert other.policy_hash != card.policy_hash


@pytest.mark.parametrize("format", ["onnx", "torchscript"])
@pytest.mark.parametrize("history", [1, 3])
def test_the_exported_file_acts_as_the_policy_that_is_told_the_trimmed_command(tmp_path, format, history):
    policy = made(history)
    given = random_observations(policy)
    given[:, VX] = np.random.default_rng(1).uniform(-0.5, 2.0, len(given))
    seen = given.copy()
    for stacked in range(history):
        column = VX + 15 * stacked
        seen[:, column] = FOUND.of(given[:, column].astype(np.float64))
    if format == "onnx":
        session = onnxruntime.InferenceSession(str(to_onnx(policy, tmp_path / "p.onnx", FOUND)))
        found = session.run(["action"], {"observation": given})[0]
    else:
        found = torch.jit.load(str(to_torchscript(policy, tmp_path / "p.ts", FOUND)))(torch.from_numpy(given)).numpy()
    np.testing.assert_allclose(found, actions(policy, seen), atol=1e-5, rtol=1e-5)
    assert np.abs(found - actions(policy, given)).max() > 0.05  # and not as one that is not


def test_the_file_says_what_it_sends(tmp_path):
    path = to_onnx(made(), tmp_path / "p.onnx", FOUND)
    said = onnxruntime.InferenceSession(str(path)).get_modelmeta().custom_metadata_map
    assert (said["held_speeds"], said["held_commands"]) == ("0.5,0.8,1.1", "0.43,0.9,1.25")
    plain = to_onnx(made(), tmp_path / "plain.onnx")
    assert "held_speeds" not in onnxruntime.InferenceSession(str(plain)).get_modelmeta().custom_metadata_map


def test_a_file_that_sends_another_command_is_found_out(tmp_path):
    policy, other = made(), HeldCommands((0.5, 0.8, 1.1), (0.43, 0.9, 1.2))
    given = random_observations(policy)
    given[:, VX] = 1.1
    assert check_export(policy, to_onnx(policy, tmp_path / "p.onnx", FOUND), "onnx", [given], FOUND) < 1e-5
    with pytest.raises(PolicyError, match="actions are off by"):
        check_export(policy, to_onnx(policy, tmp_path / "q.onnx", other), "onnx", [given], FOUND)


@pytest.mark.parametrize(
    ("speeds", "commands", "words"),
    [
        ((0.5, 0.8), (0.6, 0.55), "the commands 0.6, 0.55 m/s"),
        ((0.5, 0.8), (0.6,), "the commands 0.6 m/s"),
        ((), (), "the speeds none m/s"),
        ((-0.5, 0.8), (0.5, 0.8), "the speeds -0.5, 0.8 m/s"),
        ((0.5,), (float("nan"),), "the commands nan m/s"),
        ((0.5,), (float("inf"),), "the commands inf m/s"),
    ],
    ids=["falling", "too few", "none", "backwards", "not a number", "endless"],
)
def test_points_that_are_none_are_refused(speeds, commands, words):
    with pytest.raises(PolicyError, match=words):
        HeldCommands(speeds, commands)


def test_a_policy_that_sees_no_command_is_refused():
    policy = made()
    rest = [part for part in policy.card.observation if part["name"] != "command"]
    with pytest.raises(PolicyError, match="no command, so none can be trimmed"):
        columns(dataclasses.replace(policy.card, observation=rest))


def test_commands_are_those_of_the_final_of_best_of_its_id_and_of_its_reference(tmp_path):
    folder = run_folder(tmp_path / "run", made())
    assert held_commands_of(folder, "best") == held_commands_of(folder, "02-01") == FOUND
    assert held_commands_of(folder, "pretrained").commands == pytest.approx((0.51, 0.81, 1.11))


def test_a_command_of_another_shape_is_refused():
    policy = made()
    parts = [{**part, "size": 2} if part["name"] == "command" else part for part in policy.card.observation]
    with pytest.raises(PolicyError, match="command has 2 numbers, expected 3"):
        columns(dataclasses.replace(policy.card, observation=parts))


def test_a_speed_that_was_refused_or_at_which_it_fell_is_no_point_and_is_told(tmp_path, capsys):
    rows = {
        "0.5": {"held": True, "commanded": 0.4, "falls": 1, "reference": {"commanded": 0.5}},
        "0.8": {"held": True, "commanded": 0.7, "falls": 0, "reference": {"commanded": 0.8}},
    }
    both = {"cost": {"speeds": rows, "refused": {"1.1": "too slow"}}, "other": {"speeds": rows}}
    folder = run_folder(tmp_path / "run", made(), objectives=both)
    assert held_commands_of(folder, "best") == HeldCommands((0.8,), (0.7,), (0.5, 1.1))
    assert main(["export", str(folder), "--held-speed", "--to", str(tmp_path / "p.onnx")]) == 0
    told = capsys.readouterr().err
    assert "Commands for 0.8 m/s: 0.7; above 0.8 m/s as there. In the final it was refused or fell at 0.5, 1.1" in told


def test_a_final_that_was_refused_at_the_speed_that_it_was_to_hold_is_not_called_one_without(tmp_path, capsys):
    why = "Head-to-head at 0.8 m/s: the speeds are 1.2% apart, at most 1% counts as one speed. Trim longer."
    beside = {"speeds": {"0.8": {"held": False, "commanded": 0.8, "reference": {"commanded": 0.8}}}}
    refused = {"speeds": {}, "open_loop": beside, "refused": {"0.8": why}}
    folder = run_folder(tmp_path / "run", made(), objectives={"cost": refused, "other": refused})
    assert main(["export", str(folder), "--held-speed", "--to", str(tmp_path / "p.onnx")]) == PolicyError.exit_code
    assert capsys.readouterr().err == (
        f"error: {folder}: its final was to hold a speed and was refused, so no command of it counts. {why} "
        "Export without them, and trim on the robot.\n"
    )
    assert not (tmp_path / "p.onnx").exists()


@pytest.mark.parametrize(
    ("policy", "change", "words"),
    [
        ("00-00", {}, "the final was that of 02-01 against the pretrained policy, so commands of 00-00 are not known"),
        ("best", {"objectives": {"cost": {"speeds": {"0.8": {"held": False}}}}}, "its final held no speed"),
        ("best", {"objectives": {"cost": {"speeds": {"0.8": {"held": True}}}}}, "lacks the command that was sent"),
    ],
    ids=["another policy", "not held", "no command"],
)
def test_what_was_not_found_is_not_made_up(tmp_path, policy, change, words):
    folder = run_folder(tmp_path / "run", made(), **change)
    with pytest.raises(PolicyError, match=words):
        held_commands_of(folder, policy)


@pytest.mark.parametrize(
    ("summary", "words"),
    [(None, "has no summary.json yet"), ("{", "not what a run writes"), ("[]", "not what a run writes"),
     ('{"final": null}', "no policy of this run kept a speed in a final"),
     ('{"final": {"policy": "pretrained", "objectives": {}}}', "Export without --held-speed")],
    ids=["none yet", "torn", "something else", "no final", "the pretrained policy stayed"],
)  # fmt: skip
def test_a_run_without_a_final_says_so_in_one_line(tmp_path, summary, words):
    if summary is not None:
        (tmp_path / "summary.json").write_text(summary)
    with pytest.raises(PolicyError, match=words) as caught:
        held_commands_of(tmp_path, "best")
    assert "\n" not in str(caught.value)


def test_the_command_writes_it_and_nothing_else(tmp_path, capsys):
    folder = run_folder(tmp_path / "run", made())
    before = sorted(folder.rglob("*"))
    assert main(["export", str(folder), "--held-speed", "--to", str(tmp_path / "p.onnx")]) == 0
    given = random_observations(made())
    check_export(made(), tmp_path / "p.onnx", "onnx", [given], FOUND)
    assert sorted(folder.rglob("*")) == before


def test_a_policy_file_alone_has_no_final(tmp_path, capsys):
    file = save_policy(tmp_path / "mine", made())
    assert main(["export", "--policy", str(file), "--held-speed", "--to", str(tmp_path / "p.onnx")]) == 2
    assert "--held-speed: a policy file has no final" in capsys.readouterr().err
    assert not (tmp_path / "p.onnx").exists()


def test_a_measurement_model_holds_no_speed(tmp_path, capsys):
    given = ["export", str(tmp_path), "--measurement-model", "cost", "--held-speed", "--to", str(tmp_path / "m")]
    assert main(given) == 2
    assert "--held-speed and --measurement-model" in capsys.readouterr().err


def test_such_a_file_is_not_taken_for_the_policy(tmp_path):
    from hts.policies.importing import import_policy

    path = export_policy(run_folder(tmp_path / "run", made()), "best", "onnx", tmp_path / "p.onnx", held_speed=True)
    with pytest.raises(PolicyError, match="was exported with --held-speed"):
        import_policy(path, SPEC)
