"""A pretraining takes hours without a GPU: stopped, it goes on, to the same bits."""

from __future__ import annotations

import json

import pytest
import torch

from hts.cli.main import main
from hts.config import EnvConfig, PPOConfig, PretrainConfig
from hts.errors import RunError
from hts.locks import only_one
from hts.places import PRETRAINING
from hts.policies.files import load_policy
from hts.training import finetune as saving
from hts.training.pretrain import CHECKPOINT, LOCK, pretrain_policy, resume_pretraining
from hts_go1.plugin import make_go1

CONFIG = PretrainConfig(
    engine="mujoco",
    num_envs=4,
    steps=4 * 8 * 22,
    hidden=(16,),
    ppo=PPOConfig(horizon=8, minibatches=2, epochs=2, adaptive_rate=True),
    env=EnvConfig(threads=1, episode_seconds=0.5, randomisation={"models": 2}),
)
FILES = ["curve.json", "pretrained.json", "pretrained.safetensors"]


def made(folder):
    policy = load_policy(folder / "pretrained.safetensors")
    curve = json.loads((folder / "curve.json").read_text())
    assert sorted(path.name for path in folder.iterdir()) == FILES
    return policy.tensors, [{name: value for name, value in row.items() if name != "seconds"} for row in curve]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    pretrain_policy(make_go1({}), CONFIG, folder)
    return made(folder)


def stop_after(monkeypatch, saves: int) -> None:
    """The process ends while it says that it has written its so-many-th checkpoint."""
    left = iter(range(saves - 1, -1, -1))

    def save(*arguments, really=saving.save_checkpoint):
        really(*arguments)
        if next(left) == 0:
            raise KeyboardInterrupt

    monkeypatch.setattr(saving, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(saving, "save_checkpoint", save)


def stopped(monkeypatch, folder, saves: int) -> None:
    """A pretraining that ended after so many checkpoints."""
    with monkeypatch.context() as patch:
        stop_after(patch, saves)
        with pytest.raises(KeyboardInterrupt):
            pretrain_policy(make_go1({}), CONFIG, folder)


def test_stopped_twice_it_gives_what_it_would_have_given(whole, monkeypatch, tmp_path):
    for saves in (3, 18):  # before and behind the first row of the curve
        stopped(monkeypatch, tmp_path, saves)
        assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK, CHECKPOINT, PRETRAINING]
    rows = []
    assert resume_pretraining(tmp_path, rows.append) == tmp_path / "pretrained.safetensors"
    tensors, curve = made(tmp_path)
    assert [row["steps"] for row in rows] == [4 * 8 * 22]  # what came before was told before
    assert curve == whole[1] and [row["steps"] for row in curve] == [4 * 8 * 20, 4 * 8 * 22]
    assert all(torch.equal(tensors[name], value) for name, value in whole[0].items())


def test_a_second_process_in_the_same_folder_is_refused(tmp_path):
    with only_one(tmp_path / LOCK, "the first"), pytest.raises(RunError, match="another process is working in it"):
        pretrain_policy(make_go1({}), CONFIG, tmp_path)
    assert not (tmp_path / PRETRAINING).exists()


def test_another_one_in_the_same_folder_is_refused(monkeypatch, tmp_path):
    stopped(monkeypatch, tmp_path, 1)
    other = CONFIG.model_copy(update={"seed": 1})
    with pytest.raises(RunError, match=r"another pretraining was begun here. Go on with it: `hts resume .*`; or"):
        pretrain_policy(make_go1({}), other, tmp_path)
    assert (tmp_path / CHECKPOINT).exists()


@pytest.mark.parametrize("text", ["{", "[]", '{"robot": "go1"}', '{"robot": "go1", "config": {"seed": "x"}}'])
def test_a_file_that_does_not_say_what_was_asked_for_is_one_line(tmp_path, text):
    (tmp_path / PRETRAINING).write_text(text)
    with pytest.raises(RunError, match=r"pretraining.json: does not say what was asked for \(.*\). Begin anew"):
        resume_pretraining(tmp_path)


def test_commands_in_another_unit_are_refused_before_anything_is_written(tmp_path, capsys):
    command = ["pretrain", "--robot", "go1", "--engine", "mujoco", "--out", str(tmp_path / "mine")]
    assert main([*command, "--set", "env.commands.yaw_rate=[-57, 57]"]) == 2
    assert (
        "env.commands.yaw_rate: expected at most 20 rad/s of a robot with feet, found -57." in capsys.readouterr().err
    )
    assert not list((tmp_path / "mine").glob("*.json"))


def test_settings_that_no_env_can_be_made_with_leave_nothing_to_go_on_with(tmp_path, capsys):
    command = ["pretrain", "--robot", "go1", "--engine", "mujoco", "--out", str(tmp_path / "mine")]
    assert main([*command, "--set", "env.randomisation.delay_steps=[0,9]"]) == 2
    said = capsys.readouterr().err
    assert "9 physics steps are longer" in said and "goes on" not in said  # it would end so again
    assert list((tmp_path / "mine").iterdir()) == []
    assert main([*command, "--set", "env.commands.yaw_rate=[-57, 57]"]) == 2  # the same folder: nothing was begun
    assert "env.commands.yaw_rate: expected at most 20 rad/s" in capsys.readouterr().err


def test_the_command_says_how_it_goes_on_and_does(monkeypatch, tmp_path, capsys):
    place, asked = tmp_path / "mine", []
    for key, value in {"num_envs": 2, "steps": 64, "hidden": [8], "ppo.horizon": 8, "ppo.minibatches": 2}.items():
        asked += ["--set", f"{key}={value}"]
    command = ["pretrain", "--robot", "go1", "--engine", "mujoco", "--out", str(place), *asked]
    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        assert main(command) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"stopped: `hts resume {place}` goes on"
    assert main(command) == 2
    assert "a pretraining was begun here and is not done. Go on with it: `hts resume" in capsys.readouterr().err
    assert main(["resume", str(place)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(place / "pretrained.safetensors")
    assert sorted(path.name for path in place.iterdir()) == FILES
    assert main(["resume", str(place)]) == 2
    said = capsys.readouterr().err
    assert "holds a finished pretraining and no run, so there is nothing to go on with" in said
    assert f"Its policy is {place / 'pretrained.safetensors'}: `hts play" in said and said.count("\n") == 1
