"""`hts play`: see a policy walk, in a window or as a video.

What is seen is the training simulation of the robot's nominal model, not the real robot, and not a twin.
"""

from __future__ import annotations

import ctypes.util
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.errors import ConfigError, RunError, SimulationError
from hts.task_settings import check_speeds

if TYPE_CHECKING:
    import mujoco

    from hts.contracts import Robot

SETTLE_SECONDS = 2.0  # not counted in the mean speed
FRAME_RATE, WIDTH, HEIGHT = 25.0, 640, 480
HEADING_GAIN, YAW_RATE = 0.5, 1.0  # an operator who keeps the robot straight: rad/s per rad, at most rad/s


@dataclass(frozen=True)
class Played:
    """How a walk went: its length s, the mean forward speed m/s after the first 2 s, and whether the robot fell."""

    seconds: float
    mean_speed: float
    fell: bool


def play(
    folder: Path | None,
    policy: str | Path = "best",
    speed: float = 0.8,
    video: Path | None = None,
    seconds: float = 10.0,
    robot: str | None = None,
) -> Played:
    """Walk straight at `speed` with a policy's mean action in MuJoCo; shown in a window, or written to `video`.

    folder: of a run, or None: then policy is a file; policy: "best", "pretrained", a candidate's id, or a policy file;
    speed: commanded, m/s; video: a file that does not exist yet, such as walk.mp4; seconds: of the video (a window
    stays until it is closed); robot: by name, without a run only, by default that of the policy file.
    Raises SimulationError where there is nothing to draw with, or an action is not finite, RunError if the video
    exists, ConfigError for a speed that is not finite or in another unit, or a robot that cannot be played here.
    """
    if not math.isfinite(speed):
        raise ConfigError(f"--speed {speed}: expected a finite number, m/s.")
    if video is not None:
        video = _free(Path(video))
        _prepare_drawing()
    elif sys.platform.startswith("linux") and not _display():
        raise SimulationError(
            "There is no display to open a window on (DISPLAY and WAYLAND_DISPLAY are not set). "
            "Write a video instead: --video walk.mp4"
        )
    walk = _of_a_file(policy, robot, speed) if folder is None else _of_a_run(Path(folder), policy, robot, speed)
    check_speeds((speed,), walk.robot, "--speed")
    name = walk.robot.spec.name
    print(f"Simulation, not the real robot: '{name}', nominal training model, policy {policy}, {speed:g} m/s.")
    played = _window(walk) if video is None else _film(walk, video, seconds)
    print(f"Walked {played.seconds:.1f} s at {played.mean_speed:.2f} m/s{', then fell' if played.fell else ''}.")
    if video is not None:
        print(video)
    return played


def _of_a_run(folder: Path, policy: str | Path, robot: str | None, speed: float) -> Walk:
    from hts.config_loading import read_config
    from hts.evaluation.evaluate import policy_file
    from hts.parts import robot_of
    from hts.plugins import load

    config = read_config(folder / "config.yaml")
    if robot not in (None, config.robot.name):
        raise ConfigError(f"--robot {robot}: the robot of {folder} is '{config.robot.name}'. Leave it out.")
    return Walk(robot_of(config, load()), policy_file(folder, policy), speed)


def _of_a_file(policy: str | Path, robot: str | None, speed: float) -> Walk:
    from hts.plugins import load
    from hts.policies.deploy import DeployedPolicy
    from hts.policies.export import to_onnx
    from hts.policies.export_command import given_file
    from hts.policies.files import load_policy

    path = given_file(policy, (".safetensors", ".onnx"))
    with tempfile.TemporaryDirectory() as place:
        if path.suffix == ".safetensors":
            path = to_onnx(load_policy(path), Path(place) / f"{path.stem}.onnx")
        return Walk(load().make_robot(robot or DeployedPolicy(path).card.robot), path, speed)


class Walk:
    """One robot walking straight in the training simulation, driven by an exported policy.

    robot: with a model; policy: ONNX file; speed: commanded forward velocity, m/s.
    """

    def __init__(self, robot: Robot, policy: Path, speed: float) -> None:
        import mujoco

        from hts.policies.deploy import DeployedPolicy
        from hts.sim.conventions import check_joints
        from hts.sim.models import compile_model

        self.robot, self.speed, self._file = robot, speed, policy
        self.model = compile_model(robot)
        check_joints(self.model, robot.spec)  # below, joints are read and driven by their place
        self.data = mujoco.MjData(self.model)
        self.policy = DeployedPolicy(policy)
        made_for = self.policy.card.robot
        if made_for != robot.spec.name:
            raise ConfigError(f"{policy}: made for robot '{made_for}', this robot is '{robot.spec.name}'.")
        if (order := self.policy.card.joint_names) != list(robot.spec.joint_names):
            raise ConfigError(
                f"{policy}: its joints are {', '.join(order)}, those of robot '{made_for}' here are "
                f"{', '.join(robot.spec.joint_names)}, in this order. Play it with the package that it was made with."
            )
        self._step = mujoco.mj_step
        joints = robot.spec.num_joints
        self.data.qpos[:3] = 0.0, 0.0, robot.spec.base_height
        self.data.qpos[3:7] = 1.0, 0.0, 0.0, 0.0
        self.data.qpos[7 : 7 + joints] = robot.spec.default_pose
        mujoco.mj_forward(self.model, self.data)
        self._speeds: list[float] = []
        self.fell = False

    @property
    def seconds(self) -> float:
        """Walked so far."""
        return len(self._speeds) / self.robot.spec.control_rate_hz

    def step(self) -> None:
        """One control step: the policy looks, the physics goes on. Raises SimulationError for a target that is not
        finite, before the physics sees it."""
        spec, data = self.robot.spec, self.data
        rotation = self._rotation()
        yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
        command = (self.speed, 0.0, float(np.clip(-HEADING_GAIN * yaw, -YAW_RATE, YAW_RATE)))
        joints = slice(7, 7 + spec.num_joints), slice(6, 6 + spec.num_joints)
        readings = {
            "angular_velocity": data.qvel[3:6],
            "projected_gravity": -rotation[2],
            "command": command,
            "joint_position": data.qpos[joints[0]],
            "joint_velocity": data.qvel[joints[1]],
        }
        batch = {name: np.asarray(value, np.float32)[None] for name, value in readings.items()}
        targets = self.policy.targets(batch)[0]
        if not np.isfinite(targets).all():
            joint = spec.joint_names[int(np.argmin(np.isfinite(targets)))]
            raise SimulationError(
                f"{self._file}: its action is not finite {self.seconds:.2f} s after the start, at {self.speed:g} "
                f"m/s ({joint}). Nothing is walked with it: give another policy, or a commanded speed that it was "
                "trained for."
            )
        data.ctrl[:] = targets
        self._step(self.model, data, spec.substeps)
        rotation = self._rotation()
        self._speeds.append(float(rotation[:, 0] @ data.qvel[:3]))
        self.fell = self.fell or rotation[2, 2] < 0.5 or data.qpos[2] < 0.55 * spec.base_height

    def result(self) -> Played:
        """The walk so far."""
        counted = self._speeds[round(SETTLE_SECONDS * self.robot.spec.control_rate_hz) :] or self._speeds
        return Played(self.seconds, float(np.mean(counted)) if counted else 0.0, self.fell)

    def _rotation(self) -> np.ndarray:
        """From the trunk frame to the world, (3, 3)."""
        return self.data.xmat[self.model.body(self.robot.spec.trunk_body).id].reshape(3, 3)


def _window(walk: Walk) -> Played:
    """In MuJoCo's viewer, in real time, until it is closed."""
    import mujoco.viewer

    period = 1.0 / walk.robot.spec.control_rate_hz
    try:
        viewer = mujoco.viewer.launch_passive(walk.model, walk.data)
    except RuntimeError as error:  # on macOS only under mjpython
        raise SimulationError(f"The viewer does not open: {error} Write a video instead: --video walk.mp4") from error
    with viewer:
        _follow(walk, viewer.cam)
        while viewer.is_running():
            start = time.perf_counter()
            walk.step()
            viewer.sync()
            time.sleep(max(0.0, period - (time.perf_counter() - start)))
    return walk.result()


def _film(walk: Walk, video: Path, seconds: float) -> Played:
    """Into a file, as fast as it can be drawn. It appears whole or not at all."""
    import imageio_ffmpeg

    rate = walk.robot.spec.control_rate_hz
    stride = max(1, round(rate / FRAME_RATE))  # control steps per frame
    partial, frames = video.with_name(f".{video.stem}.partial{video.suffix}"), 0
    with _renderer(walk) as draw:
        writer = imageio_ffmpeg.write_frames(str(partial), (WIDTH, HEIGHT), fps=rate / stride)
        try:
            writer.send(None)
            for index in range(round(seconds * rate)):
                walk.step()
                if index % stride == 0:
                    writer.send(draw())
                    frames += 1
            writer.close()
            _check_frames(partial, frames)
        except OSError as error:
            partial.unlink(missing_ok=True)
            why = str(error).splitlines()[0] if str(error) else type(error).__name__  # ffmpeg's command follows
            raise SimulationError(
                f"{video}: the video cannot be written ({why}); what ffmpeg said of it is above."
            ) from error
        except BaseException:  # no half of a walk is left behind
            writer.close()
            partial.unlink(missing_ok=True)
            raise
    partial.replace(video)
    return walk.result()


def _check_frames(video: Path, frames: int) -> None:
    """Raise OSError unless all frames can be read: its writer does not say how ffmpeg ended, on a full disk say."""
    import imageio_ffmpeg

    try:
        found, _ = imageio_ffmpeg.count_frames_and_secs(str(video))
    except RuntimeError as error:
        raise OSError("what was written cannot be read") from error
    if found != frames:
        raise OSError(f"{found} of {frames} frames were written")


@contextmanager
def _renderer(walk: Walk) -> Iterator[Any]:
    """A function that draws the robot as it is now, (HEIGHT, WIDTH, 3) uint8."""
    import mujoco

    walk.model.vis.quality.offsamples = 1  # smoothed edges and shadows take most of the time where there is no GPU
    try:
        renderer = mujoco.Renderer(walk.model, HEIGHT, WIDTH)
    except Exception as error:  # each OpenGL backend fails with errors of its own
        raise _cannot_draw(error) from error
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        renderer.scene.flags[flag] = 0
    try:
        camera = mujoco.MjvCamera()
        _follow(walk, camera)

        def draw() -> np.ndarray:
            renderer.update_scene(walk.data, camera)
            return np.ascontiguousarray(renderer.render())

        yield draw
    finally:
        renderer.close()


NO_OPENGL = (
    "Install a software OpenGL and say which: `apt-get install libegl1 libgl1-mesa-dri` and MUJOCO_GL=egl, "
    "or `apt-get install libosmesa6` and MUJOCO_GL=osmesa."
)


def _cannot_draw(error: Exception) -> SimulationError:
    backend = os.environ.get("MUJOCO_GL", "not set")
    return SimulationError(f"MuJoCo cannot draw here (MUJOCO_GL={backend}: {type(error).__name__}). {NO_OPENGL}")


def _follow(walk: Walk, camera: mujoco.MjvCamera) -> None:
    """Walk beside the robot."""
    import mujoco

    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = walk.model.body(walk.robot.spec.trunk_body).id
    camera.distance, camera.azimuth, camera.elevation = 6.0 * walk.robot.spec.base_height, 110.0, -15.0


def _free(video: Path) -> Path:
    """A place where a video can be written."""
    if video.suffix != ".mp4":
        raise ConfigError(f"--video {video}: expected a file that ends in .mp4.")
    if video.exists():
        raise RunError(f"{video}: exists already. Choose another file with --video.")
    if not video.parent.is_dir():
        raise RunError(f"{video}: there is no folder '{video.parent}'. Make it, or choose another file with --video.")
    return video


def _display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _prepare_drawing() -> None:
    """Load MuJoCo; without a display drawing off screen must be chosen before. Raises SimulationError."""
    if not os.environ.get("MUJOCO_GL") and sys.platform.startswith("linux") and not _display():
        backends = [
            backend for library, backend in (("EGL", "egl"), ("OSMesa", "osmesa")) if ctypes.util.find_library(library)
        ]
        if not backends:
            raise SimulationError(
                f"There is nothing to draw with: no display, no EGL, no OSMesa was found. {NO_OPENGL}"
            )
        os.environ["MUJOCO_GL"] = backends[0]
    try:
        import mujoco  # noqa: F401
    except (ImportError, AttributeError, RuntimeError) as error:  # so it says that MUJOCO_GL's library is missing
        raise _cannot_draw(error) from error
