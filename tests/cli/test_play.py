"""`hts play`: what it says when there is nothing to draw with, and the walk it shows."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from hts import play as module
from hts.config_loading import dump_config, load_config
from hts.errors import ConfigError, PolicyError, RunError, SimulationError

pytest.importorskip("hts_go1", reason="the walk needs an installed robot with a model")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a configuration and the shipped policy, as a run has them after its first moment."""
    from hts.plugins import load
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    folder = tmp_path_factory.mktemp("run")
    config = load_config(preset="smoke", objectives=["anything"], robot="go1")
    (folder / "config.yaml").write_text(dump_config(config), encoding="utf-8")
    (folder / "policies").mkdir()
    source = load().make_robot("go1").pretrained_policy()
    to_onnx(load_policy(source), folder / "policies" / "pretrained.onnx")
    return folder


@pytest.fixture
def walk(run_folder: Path) -> module.Walk:
    from hts.plugins import load

    return module.Walk(load().make_robot("go1"), run_folder / "policies" / "pretrained.onnx", 0.8)


def test_the_pretrained_policy_walks_at_the_commanded_speed_and_does_not_fall(walk):
    for _ in range(200):
        walk.step()
    result = walk.result()
    assert result.seconds == pytest.approx(4.0)
    assert result.mean_speed == pytest.approx(0.8, rel=0.1)
    assert not result.fell


def test_the_mean_speed_counts_from_two_seconds_on(walk):
    walk._speeds = [0.0] * 100 + [1.0, 3.0]  # 50 Hz
    assert walk.result().mean_speed == 2.0


def test_a_robot_on_its_back_has_fallen(walk):
    walk.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0
    walk.step()
    assert walk.result().fell


def test_a_policy_of_another_robot_is_refused_by_name(walk, run_folder, monkeypatch):
    from dataclasses import replace

    robot = walk.robot
    monkeypatch.setattr(robot, "spec", replace(robot.spec, name="other"), raising=False)
    with pytest.raises(ConfigError, match="made for robot 'go1', this robot is 'other'"):
        module.Walk(robot, run_folder / "policies" / "pretrained.onnx", 0.8)


def test_a_model_with_its_joints_in_another_order_is_refused_as_training_refuses_it(walk, run_folder, monkeypatch):
    """Joints are read, and actuators driven, by their place: such a walk would be of scrambled legs."""
    robot = walk.robot

    def other():
        root = type(robot).mjcf(robot)
        first = root.actuator.position[0]
        given = first.get_attributes()
        first.remove()
        root.actuator.add("position", **given)  # now the last one
        return root

    monkeypatch.setattr(robot, "mjcf", other)
    joint = robot.spec.joint_names[0]
    with pytest.raises(
        ConfigError, match=rf"number 1 among the actuators of its model, '{joint}' is expected"
    ) as caught:
        module.Walk(robot, run_folder / "policies" / "pretrained.onnx", 0.8)
    assert "\n" not in str(caught.value)


def test_a_policy_whose_joints_are_in_another_order_is_refused(walk, run_folder, monkeypatch):
    from dataclasses import replace

    robot = walk.robot
    turned = (*robot.spec.joint_names[1:], robot.spec.joint_names[0])
    monkeypatch.setattr(robot, "spec", replace(robot.spec, joint_names=turned), raising=False)
    monkeypatch.setattr("hts.sim.conventions.check_joints", lambda model, spec: None)  # a model that goes with it
    with pytest.raises(ConfigError, match=r"pretrained.onnx: its joints are .*, in this order") as caught:
        module.Walk(robot, run_folder / "policies" / "pretrained.onnx", 0.8)
    assert "\n" not in str(caught.value)


def test_without_a_display_the_error_says_to_write_a_video(run_folder, monkeypatch):
    monkeypatch.setattr(module.sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SimulationError, match="--video walk.mp4"):
        module.play(run_folder, policy="pretrained")


def test_without_any_opengl_the_error_says_what_to_install(run_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module.sys, "platform", "linux")
    monkeypatch.setattr(module.ctypes.util, "find_library", lambda name: None)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SimulationError, match="apt-get install libegl1") as caught:
        module.play(run_folder, policy="pretrained", video=tmp_path / "walk.mp4")
    assert "\n" not in str(caught.value)


def test_a_renderer_that_fails_becomes_one_line_that_names_the_backend(walk, monkeypatch):
    import mujoco

    def broken(*_):
        raise AttributeError("glGetError")

    monkeypatch.setattr(mujoco, "Renderer", broken)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(SimulationError, match="MUJOCO_GL=osmesa: AttributeError"), module._renderer(walk):
        pass


def test_an_existing_video_is_not_overwritten(run_folder, tmp_path):
    video = tmp_path / "walk.mp4"
    video.write_bytes(b"kept")
    with pytest.raises(RunError, match="exists already"):
        module.play(run_folder, policy="pretrained", video=video)
    assert video.read_bytes() == b"kept"


def test_a_video_of_another_kind_is_refused(run_folder, tmp_path):
    with pytest.raises(ConfigError, match="ends in .mp4"):
        module.play(run_folder, policy="pretrained", video=tmp_path / "walk.png")


@pytest.mark.parametrize("ending", [".safetensors", ".onnx"])
def test_a_policy_file_walks_without_a_run_as_the_robot_it_was_made_for(run_folder, ending):
    from hts.plugins import load

    source = load().make_robot("go1").pretrained_policy()
    file = source if ending == ".safetensors" else run_folder / "policies" / "pretrained.onnx"
    walk = module._of_a_file(file, None, 0.8)
    walk.step()
    assert walk.robot.spec.name == "go1" and walk.seconds == pytest.approx(0.02)


def test_without_a_run_a_policy_must_be_a_file_and_with_one_the_robot_is_the_runs(run_folder, tmp_path):
    with pytest.raises(PolicyError, match="best: expected a policy file that exists, ending in .safetensors or .onnx"):
        module._of_a_file("best", None, 0.8)
    with pytest.raises(ConfigError, match="--robot other: the robot of .* is 'go1'. Leave it out."):
        module._of_a_run(run_folder, "pretrained", "other", 0.8)


def test_a_robot_with_an_env_of_its_own_and_no_model_is_not_advised_about_logs(run_folder):
    from hts.contracts import LogOnlyRobot, Robot
    from hts.plugins import load

    spec = load().make_robot("go1").spec

    class Own(LogOnlyRobot):
        def make_env(self, *given, **named):
            raise AssertionError("not asked here")

    def said(robot: Robot) -> str:
        with pytest.raises(ConfigError, match="has no model") as caught:
            module.Walk(robot, run_folder / "policies" / "pretrained.onnx", 0.8)
        return str(caught.value)

    assert "hts import" in said(LogOnlyRobot(spec, []))
    assert "env of its own" in said(Own(spec, [])) and "log" not in said(Own(spec, []))


def test_a_film_has_25_frames_a_second_and_is_said_to_be_simulation(run_folder, tmp_path, monkeypatch, capsys):
    import imageio_ffmpeg

    class Grey:
        def __enter__(self):
            return lambda: np.full((module.HEIGHT, module.WIDTH, 3), 128, np.uint8)

        def __exit__(self, *_):
            return False

    monkeypatch.setattr(module, "_prepare_drawing", lambda: None)
    monkeypatch.setattr(module, "_renderer", lambda walk: Grey())
    video = tmp_path / "walk.mp4"
    played = module.play(run_folder, policy="pretrained", video=video, seconds=1.0)
    assert played.seconds == pytest.approx(1.0)
    assert imageio_ffmpeg.count_frames_and_secs(str(video))[0] == 25
    assert "Simulation, not the real robot" in capsys.readouterr().out
    assert [file.name for file in tmp_path.iterdir()] == ["walk.mp4"]


CUT_OFF = """
python - > "$OUT/out" 2> "$OUT/err" <<END
import numpy as np
from pathlib import Path
from contextlib import nullcontext
from hts import play
from hts.plugins import load

walk = play.Walk(load().make_robot("go1"), Path("$OUT/pretrained.onnx"), 0.8)
noise = np.random.default_rng(0).integers(0, 255, (play.HEIGHT, play.WIDTH, 3), dtype=np.uint8)
play._renderer = lambda walk: nullcontext(lambda: noise)
try:
    play._film(walk, Path("$DISK/walk.mp4"), 0.4)
except play.SimulationError as error:
    print(error)
END
ls -A "$DISK" > "$OUT/left"
"""


def test_a_video_that_a_full_disk_cuts_off_is_refused_and_nothing_of_it_stays(on_a_disk, run_folder, tmp_path):
    shutil.copy(run_folder / "policies" / "pretrained.onnx", tmp_path)
    on_a_disk("64k", f'python() {{ "{sys.executable}" "$@"; }}\n{CUT_OFF}', modules="")
    said = (tmp_path / "out").read_text()
    why = "(what was written cannot be read); what ffmpeg said of it is above."
    assert said == f"{tmp_path}/disk/walk.mp4: the video cannot be written {why}\n", (tmp_path / "err").read_text()
    assert "No space left on device" in (tmp_path / "err").read_text()
    assert (tmp_path / "left").read_text() == ""


@pytest.mark.parametrize("speed", [float("nan"), float("inf"), -float("inf")])
def test_a_speed_that_is_not_finite_is_refused_before_anything_is_drawn(run_folder, tmp_path, speed):
    with pytest.raises(ConfigError, match=r"^--speed (nan|-?inf): expected a finite number, m/s\.$"):
        module.play(run_folder, policy="pretrained", speed=speed, video=tmp_path / "walk.mp4")


def test_a_speed_in_another_unit_is_refused_before_anything_is_drawn(run_folder, tmp_path):
    with pytest.raises(ConfigError, match=r"^--speed: expected at most 20 m/s of a robot with feet, found 800"):
        module.play(run_folder, policy="pretrained", speed=800.0, video=tmp_path / "walk.mp4")
    assert not list(tmp_path.glob("*.mp4"))


def test_an_action_that_is_not_finite_stops_the_walk_and_leaves_no_video(walk, tmp_path, monkeypatch):
    from contextlib import nullcontext

    targets = walk.policy.targets

    def broken_after_two_steps(batch):
        found = targets(batch).copy()
        found[0, 3] = np.nan if walk.seconds > 0.03 else found[0, 3]
        return found

    monkeypatch.setattr(walk.policy, "targets", broken_after_two_steps)
    picture = np.zeros((module.HEIGHT, module.WIDTH, 3), np.uint8)
    monkeypatch.setattr(module, "_renderer", lambda walk: nullcontext(lambda: picture))
    joint = walk.robot.spec.joint_names[3]
    with pytest.raises(
        SimulationError, match=rf"pretrained.onnx: its action is not finite 0.04 s .* \({joint}\)"
    ) as caught:
        module._film(walk, tmp_path / "walk.mp4", 1.0)
    assert "\n" not in str(caught.value)
    assert np.isfinite(walk.data.ctrl).all()
    assert not list(tmp_path.iterdir())
