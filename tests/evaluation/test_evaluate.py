"""`hts evaluate`: what it refuses before anything is walked, and what a world that has to wait is told to say."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hts.config_loading import dump_config, load_config, read_config
from hts.contracts import Task, World
from hts.errors import ConfigError, HtsError, RunError
from hts.evaluation.evaluate import command_of, evaluate_run, policy_file
from hts.locks import only_one
from hts.overrides import Override
from hts.plugins import Entry, Registry
from hts.testing.examples.robot.robot import Tiny
from hts.testing.made_up_recordings import CostObjective


class Asked(HtsError):
    """The world was asked for the head-to-head."""


class Asking(World):
    """Ends where it is asked, with what it knows then."""

    name = "asking"

    def __init__(self, context) -> None:
        self.context = context

    def idle(self):
        return {"cost": 0.0}

    def collect(self, policies, schedule):
        return []

    def hold_speed(self, hold):
        return True

    def head_to_head(self, policy, reference, speeds):
        raise Asked(list(speeds), self.context.command)


@pytest.fixture
def registry() -> Registry:
    return Registry(
        objectives={"cost": Entry("cost", lambda settings: CostObjective(), "tests")},
        robots={"tiny": Entry("tiny", lambda settings: Tiny(), "tests")},
        worlds={"asking": Entry("asking", lambda settings, context: Asking(context), "tests")},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return made(tmp_path / "my run", "evaluation.hold_speed=false")


def made(folder: Path, *overrides: str) -> Path:
    config = load_config(preset="quick", objectives=["cost"], robot="tiny", world="asking", overrides=overrides)
    (folder / "policies").mkdir(parents=True)
    (folder / "config.yaml").write_text(dump_config(config))
    for name in ("best", "pretrained"):
        (folder / "policies" / f"{name}.onnx").write_bytes(b"")
    return folder


@pytest.mark.parametrize("speed", [math.nan, math.inf, -math.inf, "a", True, None])
def test_a_speed_that_is_no_finite_number_is_refused(folder, registry, speed):
    with pytest.raises(ConfigError, match=r"^--speed: expected a finite number, found ") as caught:
        evaluate_run(folder, speeds=[0.8, speed], registry=registry)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_so_is_one_at_which_nobody_walks_ahead(folder, registry, speed):
    with pytest.raises(ConfigError, match=rf"^--speed: expected a number greater than 0, found {speed:g}\.$"):
        evaluate_run(folder, speeds=[speed], registry=registry)


@pytest.mark.parametrize("speed", [800.0, 28.8])
def test_so_is_one_in_another_unit_as_in_a_run(folder, registry, speed):
    unit = r"It is probably in another unit: write m/s, not km/h or mm/s\.$"
    said = rf"expected at most 20 m/s of a robot with feet, found {speed:g}\. {unit}"
    with pytest.raises(ConfigError, match=f"^--speed: {said}"):
        evaluate_run(folder, speeds=[0.8, speed], registry=registry)
    with pytest.raises(ConfigError, match=rf"^evaluation\.speeds: {said}"):
        evaluate_run(folder, registry=registry, overrides=[f"evaluation.speeds=[{speed}]"])


def test_wheels_may_be_faster_and_set_points_of_another_task_are_no_speeds(folder, registry):
    class Wheeled(Tiny):
        spec = dataclasses.replace(Tiny.spec, foot_sites=())

    class Heights(Task):
        quantity, unit, channels, set_points = "height", "mm", ("height",), (800.0,)

        def achieved(self, channels):
            return channels["height"]

        def done(self, achieved, set_point, tolerance):
            return abs(achieved - set_point) < tolerance

    class Crane(Tiny):
        def task(self):
            return Heights()

    registry.robots["tiny"] = Entry("tiny", lambda settings: Wheeled(), "tests")
    with pytest.raises(Asked):
        evaluate_run(folder, speeds=[28.8], registry=registry)
    with pytest.raises(ConfigError, match=r"^--speed: expected at most 100 m/s, found 800\. "):
        evaluate_run(folder, speeds=[800.0], registry=registry)
    registry.robots["tiny"] = Entry("tiny", lambda settings: Crane(), "tests")
    with pytest.raises(Asked):
        evaluate_run(folder, speeds=[800.0], registry=registry)


def test_a_speed_is_asked_for_once_since_a_second_time_is_no_more_of_the_same_block(folder, registry):
    with pytest.raises(ConfigError, match=r"^--speed: 0\.8 is there twice; ask for each once\. --sessions 2 "):
        evaluate_run(folder, speeds=[0.8, 0.5, 0.8], registry=registry)


@pytest.mark.parametrize("speeds", ["0.8", 0.8])
def test_speeds_are_a_list(folder, registry, speeds):
    with pytest.raises(ConfigError, match="^--speed: expected a list of numbers, found "):
        evaluate_run(folder, speeds=speeds, registry=registry)


def test_a_speed_that_cannot_be_held_is_refused_as_in_a_run(tmp_path, registry):
    held = made(tmp_path / "held", "evaluation.hold_speed=true")
    low, high = read_config(held / "config.yaml").finetune.env.commands.vx
    with pytest.raises(
        ConfigError, match=f"^--speed: 15 m/s cannot be held with commands from {low:g} to {high:g} m/s"
    ):
        evaluate_run(held, speeds=[0.8, 15.0], registry=registry)


def test_a_speed_may_be_a_number_of_numpy(folder, registry):
    with pytest.raises(Asked) as caught:
        evaluate_run(folder, speeds=[np.float32(0.5), 1], registry=registry)
    assert caught.value.args[0] == [0.5, 1]


@pytest.mark.parametrize("sessions", [0, -1])
def test_it_is_done_once_at_least(folder, registry, sessions):
    with pytest.raises(ConfigError, match=rf"^--sessions: expected a whole number from 1 on, found {sessions}\.$"):
        evaluate_run(folder, speeds=[0.8], sessions=sessions, registry=registry)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_that_no_generator_takes_is_refused(folder, registry, seed):
    with pytest.raises(ConfigError, match=rf"^--seed: expected a whole number from 0 .*, found {seed}\.$"):
        evaluate_run(folder, speeds=[0.8], seed=seed, registry=registry)


@pytest.mark.parametrize(("policy", "best", "told"), [(None, b"", 1), ("pretrained", b"", 0), (None, b"another", 0)])
def test_a_comparison_of_the_pretrained_policy_with_itself_is_called_so(folder, registry, policy, best, told):
    (folder / "policies" / "best.onnx").write_bytes(best)
    said: list[str] = []
    with pytest.raises(Asked):
        evaluate_run(folder, policy=policy, registry=registry, say=said.append)
    assert len(said) == told and all("compares it with itself" in line for line in said)


def test_a_world_is_told_the_whole_command_that_asks_again(folder, registry):
    with pytest.raises(Asked) as caught:
        evaluate_run(folder, [0.5, 0.85], "pretrained", "asking", seed=3, registry=registry)
    typed = ["hts", "evaluate", str(folder), "--speed", "0.5", "--speed", "0.85"]
    typed += ["--policy", "pretrained", "--world", "asking", "--seed", "3"]
    assert shlex.split(caught.value.args[1]) == typed
    assert f"'{folder}'" in caught.value.args[1]  # its name has a blank


def test_what_was_left_out_stays_left_out():
    assert command_of(Path("r1"), (), "best", None, None, None) == "hts evaluate r1"
    assert command_of(Path("r1"), (), None, "field", 0, 4) == "hts evaluate r1 --world field --seed 0 --sessions 4"


def exported_by_hash(monkeypatch) -> None:
    """Of each policy no more than its hash is real: that of its folder's name."""
    monkeypatch.setattr("hts.policies.export.to_onnx", lambda policy, to: to)
    monkeypatch.setattr(
        "hts.policies.files.load_policy", lambda path: SimpleNamespace(card=policy_of(path.parent.name))
    )


def policy_of(text: str) -> SimpleNamespace:
    return SimpleNamespace(policy_hash=hashlib.sha256(text.encode()).hexdigest())


def test_files_of_one_name_from_two_folders_do_not_take_each_others_place(folder, tmp_path, monkeypatch):
    exported_by_hash(monkeypatch)
    (folder / "policies" / "pretrained.onnx").unlink()
    files = [tmp_path / name / "pretrained.safetensors" for name in ("one", "other")]
    for file in (*files, folder / "policies" / "pretrained.safetensors"):
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"")
        file.with_suffix(".json").write_text("{}")
    assert len({policy_file(folder, one) for one in (*files, "pretrained")}) == 3


def test_what_the_gate_found_goes_with_parameters_that_are_exported(folder, monkeypatch):
    exported_by_hash(monkeypatch)
    parameters = folder / "00-00.safetensors"
    parameters.write_bytes(b"")
    parameters.with_suffix(".gate.json").write_text('{"passed": false}')
    beside = policy_file(folder, parameters).with_suffix(".gate.json")
    assert beside.parent == folder / "evaluation" and beside.read_text() == '{"passed": false}'
    parameters.with_suffix(".gate.json").unlink()
    policy_file(folder, parameters)
    assert not beside.exists()  # nor does that of another one stay


def test_other_settings_are_laid_over_the_runs_for_this_once_and_asked_for_again(folder, registry):
    with pytest.raises(Asked) as caught:
        evaluate_run(folder, registry=registry, overrides=["evaluation.speeds=[0.6]", "evaluation.trim_seconds=30"])
    speeds, command = caught.value.args
    assert speeds == [0.6]
    words = ["--set", "evaluation.speeds=[0.6]", "--set", "evaluation.trim_seconds=30"]
    assert shlex.split(command) == ["hts", "evaluate", str(folder), *words]
    assert read_config(folder / "config.yaml").evaluation.trim_seconds != 30


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("finetune.steps=1", r"--set finetune\.steps=1: has made the run's policies and cannot be another one"),
        ("robot.name=other", r"--set robot\.name=other: has made the run's policies"),
        ("world.name=asking", r"--set world\.name=asking: say --world NAME\."),
        ("world=asking", r"--set world=asking: say --world NAME\."),
        (
            "evaluation.speedz=[0.6]",
            r"--set evaluation\.speedz: there is no key .speedz. in evaluation\. Did you mean .speeds.\?",
        ),
        ("evaluation.trim_seconds=-1", r"--set evaluation\.trim_seconds: "),
        ("evaluation", "--set evaluation: expected KEY=VALUE"),
    ],
)
def test_other_settings_that_are_none_of_an_evaluations_are_refused(folder, registry, override, said):
    with pytest.raises(ConfigError, match=f"^{said}") as caught:
        evaluate_run(folder, registry=registry, overrides=[override])
    assert "\n" not in str(caught.value) and not (folder / "evaluation").exists()


def test_other_settings_may_be_values_of_python_that_json_can_hold(folder, registry, tmp_path):
    laid = [Override.of("world.reality", tmp_path / "mine.json"), Override.of("evaluation.speeds", (0.6,))]
    with pytest.raises(Asked) as caught:
        evaluate_run(folder, registry=registry, overrides=laid)
    words = ["--set", f'world.reality="{tmp_path}/mine.json"', "--set", "evaluation.speeds=[0.6]"]
    assert shlex.split(caught.value.args[1])[3:] == words
    with pytest.raises(ConfigError, match=r"^evaluation\.trim_seconds: \w+, expected what JSON can hold"):
        evaluate_run(folder, registry=registry, overrides=[Override.of("evaluation.trim_seconds", np.float32(20.0))])


def test_one_run_is_evaluated_once_at_a_time(folder, registry):
    (folder / "evaluation").mkdir()
    with (
        only_one(folder / "evaluation" / ".lock", "the first"),
        pytest.raises(RunError, match="another evaluation of this run is being made. Wait for it"),
    ):
        evaluate_run(folder, speeds=[0.8], registry=registry)
    with pytest.raises(Asked):
        evaluate_run(folder, speeds=[0.8], registry=registry)
