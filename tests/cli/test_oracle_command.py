"""`hts oracle`: a whole run, what it says of itself, and how mistakes end."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hts.cli.main import main
from hts.plugins import load
from hts.rl.population import Population
from hts.run import algorithm
from hts.worlds.oracle import NOTE

pytest.importorskip("hts_go1", reason="the robot of this test comes with it")
pytest.importorskip("hts_power", reason="the objective of this test comes with it")

TINY = [
    *("--objective", "power", "--robot", "go1", "--preset", "smoke", "--steps", "48"),
    *("--set", "finetune.num_envs=4", "--set", "finetune.ppo.horizon=12", "--set", "sweep.weights.power=[1.0]"),
    *("--set", "simulation_test.num_envs=2", "--set", "simulation_test.seconds=3", "--set", "world.block_seconds=3"),
]


@pytest.mark.slow
def test_an_oracle_ends_with_a_summary_that_says_what_it_is(oracle_run, capsys):
    run = oracle_run.folder
    assert NOTE in run.with_name("printed.txt").read_text()
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["note"], summary["reward_source"]) == (NOTE, "oracle")
    (candidate,) = summary["iterations"][0]["candidates"]
    assert candidate["kl_bound"] is None and candidate["elite"]
    assert NOTE in (run / "report.html").read_text() and "No method." in (run / "report.html").read_text()
    assert main(["oracle", *TINY, "--out", str(run)]) != 0
    assert "holds a run already" in capsys.readouterr().err


@pytest.mark.slow
def test_where_it_starts_from_is_a_candidate_too_and_a_resumed_one_knows(tmp_path, monkeypatch):
    run, policy = tmp_path / "run", load().make_robot("go1").pretrained_policy()
    with monkeypatch.context() as patch:
        patch.setattr(algorithm, "test", pulled)
        with pytest.raises(RuntimeError, match="pulled the plug"):
            main(["oracle", *TINY, "--start", str(policy), "--out", str(run)])
    assert main(["resume", str(run)]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert [one["id"] for one in summary["iterations"][0]["candidates"]] == ["00-00", "00-start"]
    start = summary["iterations"][0]["candidates"][1]
    assert (start["kl"], start["kl_bound"], start["elite"], summary["note"]) == (0.0, 0.0, True, NOTE)


def pulled(*given):
    raise RuntimeError("pulled the plug")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--set", "world.reality=gone.json"], "reality gone.json: there is no such file"),
        (["--set", "world.reality=dev-0O"], "No reality named 'dev-0O'. Did you mean 'dev-"),
        (["--world", "field"], "World 'field' cannot be looked into: an oracle needs a twin"),
        (["--start", "gone.safetensors"], "gone.safetensors: expected a policy file that exists"),
        (["--steps", "0"], "finetune.steps"),
        (["--set", "reward_source=model"], "reward_source"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(tmp_path, capsys, options, said):
    assert main(["oracle", *TINY, *options, "--out", str(tmp_path / "run")]) != 0
    err = capsys.readouterr().err.strip()
    assert "\n" not in err and said in err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("options", [["--reward", "oracle"], ["--set", "reward_source=oracle"]])
def test_no_run_may_look_inside(tmp_path, capsys, options):
    given = ["--objective", "power", "--robot", "go1", "--preset", "smoke", "--out", str(tmp_path / "run")]
    assert main(["run", *given, *options]) != 0
    assert "looks into the reality, which no run can" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_start_of_another_size_is_one_line(tmp_path, capsys):
    from hts.policies.files import Policy, load_policy, make_card, save_policy

    robot = load().make_robot("go1")
    shipped = load_policy(robot.pretrained_policy(), robot.spec)
    sizes = replace(shipped.card.sizes(), hidden=(8,))
    tensors = Population(sizes, 1).candidate(0)
    card = make_card(robot.spec, tensors, [dict(part) for part in shipped.card.observation], sizes)
    path = save_policy(tmp_path / "small.safetensors", Policy(tensors, card))
    assert main(["oracle", *TINY, "--start", str(path), "--out", str(tmp_path / "run")]) != 0
    err = capsys.readouterr().err.strip()
    assert "\n" not in err and "small.safetensors: has networks of" in err and "fine-tuned from it" in err


def test_a_run_starts_from_no_other_policy(tmp_path, capsys):
    given = ["--objective", "power", "--robot", "go1", "--preset", "smoke", "--out", str(tmp_path / "run")]
    assert main(["run", *given, "--set", "start=p.safetensors"]) != 0
    assert "only `hts oracle` starts from another policy" in capsys.readouterr().err
