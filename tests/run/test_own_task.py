"""A robot whose task is not to follow a velocity: its set-points, its own test of what counts, in a whole run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hts.api import load as load_run
from hts.api import run as run_from_python
from hts.config import Command, ScheduleConfig
from hts.config_loading import check_names, dump_config, load_config, read_config
from hts.contracts import HoldSpeed, WorldContext
from hts.errors import ConfigError, PluginError, UnfitWorldError, WaitingForRobot
from hts.evaluation.head_to_head import TooFewSegments, compare
from hts.evaluation.segments import cut
from hts.plugins import load
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.presets import PRESETS
from hts.testing.conformance import check_package
from hts.testing.packages import on_path, write_package
from hts.worlds.field import make_field

CODE = (Path(__file__).parent / "crane_demo.py").read_text(encoding="utf-8")
PLUGIN = '''
"""Registers the crane, its objective and its world."""

from hts import hookimpl
from hts.config import Config

HTS_API = 2


class Settings(Config):
    """There are none."""


def make_crane(settings):
    """A crane."""
    import crane_demo

    Settings(**settings)
    return crane_demo.Crane()


def make_thrift(settings):
    """Less power."""
    import crane_demo

    Settings(**settings)
    return crane_demo.Thrift()


def make_yard(settings, context):
    """A yard with a crane."""
    import crane_demo
    from hts.errors import WorldError

    Settings(**settings)
    if context.robot != "crane":
        raise WorldError("World 'yard' has a crane and nothing else: use --robot crane.")
    return crane_demo.Yard()


@hookimpl
def hts_robots(register):
    register("crane", make_crane)


@hookimpl
def hts_objectives(register):
    register("thrift", make_thrift)


@hookimpl
def hts_worlds(register):
    register("yard", make_yard)
'''


@pytest.fixture(scope="module", autouse=True)
def crane(tmp_path_factory):
    """The module of the package, while it is installed."""
    folder = tmp_path_factory.mktemp("site")
    with on_path(
        write_package(
            folder, "crane-demo", {"crane_demo.py": CODE, "crane_plugin.py": PLUGIN}, {"crane": "crane_plugin"}
        )
    ):
        import crane_demo

        yield crane_demo


def config(**given):
    return load_config(
        **{"preset": "smoke", "objectives": ["thrift"], "robot": "crane", "world": "yard", "registry": load(), **given}
    )


# ------------------------------------------------------------------------------------------------ a whole run


def test_a_run_judges_it_by_its_own_test_at_its_own_set_points(tmp_path):
    small = {"finetune.num_envs": 2, "finetune.steps": 48, "sweep.kl_bounds": [0.1], "measurement.epochs": 1}
    folder = run_from_python("thrift", "crane", out=tmp_path / "run", preset="smoke", world="yard", settings=small)
    summary = load_run(folder).summary
    assert summary["task"] == {"velocity": False, "quantity": "hook height", "unit": "m", "commanded": True}
    (candidate,) = summary["iterations"][0]["candidates"]
    assert candidate["tracked"] and candidate["elite"]
    speeds = summary["final"]["objectives"]["thrift"]["speeds"]
    assert list(speeds) == ["0.4", "0.8"]
    assert [speeds[key]["mean_speed"] for key in speeds] == pytest.approx([0.4, 0.8], abs=0.05)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert (
        "at 0.4 m" in page and "mean hook height" in page and "m/s" not in page.split("<h2>Words")[0].split("<svg")[0]
    )


def test_its_package_keeps_every_demand_of_the_kit():
    lines = [finding.line() for finding in check_package(load(), "crane-demo") if finding.fault is not None]
    assert lines == []


# ----------------------------------------------------------------------------------------------- what counts


def held(height: float, set_point: float, seconds: float = 6.0, role: str = "policy"):
    import crane_demo

    steps = round(seconds * crane_demo.RATE)
    channels = {
        "hook_height": np.full(steps, height),
        "winch_speed": np.zeros(steps),
        "supply_power": np.full(steps, 30.0),
    }
    one = crane_demo.Yard()._one(POLICY[0], crane_demo.HoldHeight().schedule(set_point, seconds), "s", role, 0)
    made = {name: type(series)(series.channel, channels[name]) for name, series in one.channels.items()}
    return one.replace(channels=made)


POLICY: list[Path] = []


@pytest.fixture(autouse=True)
def policy(crane, tmp_path) -> Path:
    source = load_policy(crane.Crane().pretrained_policy(), crane.SPEC)
    POLICY[:] = [to_onnx(source, tmp_path / "policy.onnx")]
    return POLICY[0]


def test_seconds_in_which_the_task_was_done_count_and_no_others(crane):
    task = crane.HoldHeight()
    segments = cut([held(0.42, 0.4), held(0.5, 0.4)], task=task)
    assert (len(segments), segments.total) == (4, 8)
    assert segments.speed == pytest.approx(0.42) and segments.commanded.tolist() == [0.4] * 4


def test_a_policy_that_does_not_do_it_is_refused_in_the_words_of_its_task(crane):
    recordings = [held(0.2, 0.4), held(0.4, 0.4, role="reference")]
    with pytest.raises(TooFewSegments, match=r"at 0.4 m: 0 of 4 .*the task was done in them; hook height 0.2 m on av"):
        compare(
            crane.Thrift(), recordings, config().evaluation.model_copy(update={"min_valid": 0.5}), 0, crane.HoldHeight()
        )


def test_a_task_that_gives_no_number_a_sample_is_the_plugins_fault(crane):
    class Odd(crane.HoldHeight):
        def achieved(self, channels):
            return channels["hook_height"].mean()

    with pytest.raises(PluginError, match=r"Odd.achieved gives shape \(\) for 120 samples"):
        cut([held(0.4, 0.4)], task=Odd())


# --------------------------------------------------------------------------------------------- configuration


def test_the_task_brings_its_set_points_to_every_preset(tmp_path):
    for preset in ("smoke", "quick", "paper"):
        found = config(preset=preset)
        assert found.simulation_test.speeds == found.evaluation.speeds == (0.4, 0.8)
        assert found.selection.tested_speeds == (0.4,)
        assert not found.evaluation.hold_speed and not found.simulation_test.hold_speed
        assert [command.set_point for command in found.collection.schedule.commands] == [0.4, 0.8]
        file = tmp_path / f"{preset}.yaml"
        file.write_text(dump_config(found))
        assert read_config(file) == found


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("evaluation.speeds=[0.5]", "evaluation.speeds: expected a set-point of the task, 0.4 or 0.8 m, found 0.5"),
        ("selection.speed=1.1", "selection.speed: expected a set-point"),
        (
            "collection.schedule.commands=[{seconds: 4, vx: 0.5}]",
            "collection.schedule.commands.0: commands a velocity, but this robot's task follows none",
        ),
        ("collection.schedule.commands=[{seconds: 4, set_point: 0.6}]", "collection.schedule: expected a set-point"),
        ("selection.speeds=[0.4, 1.1]", "selection.speeds: expected a set-point of the task, 0.4 or 0.8 m, found 1.1"),
        (
            "evaluation.hold_speed=true",
            "evaluation.hold_speed: expected false, found true. This robot's task is judged by its hook height; only a",
        ),
        ("simulation_test.hold_speed=true", "simulation_test.hold_speed: expected false, found true"),
    ],
)
def test_a_set_point_that_the_task_does_not_have_is_one_line(override, words):
    with pytest.raises(ConfigError, match=words.replace("(", r"\(")) as caught:
        check_names(config(overrides=[override]), load())
    assert "\n" not in str(caught.value)


def test_a_set_point_is_nothing_for_a_robot_that_follows_a_velocity():
    sets = ["collection.schedule.commands=[{seconds: 4, set_point: 0.4}]"]
    given = {"objectives": ["power"], "robot": "go1", "world": "twin"}
    with pytest.raises(ConfigError, match="this robot follows a commanded velocity. Write vx"):
        check_names(config(**given, overrides=sets), load())
    with pytest.raises(ConfigError, match="selection.speed: expected a number greater than 0"):
        check_names(config(**given, overrides=["selection.speed=0"]), load())
    with pytest.raises(ConfigError, match="selection.speeds: expected a number greater than 0, found -0.5"):
        check_names(config(**given, overrides=["selection.speeds=[0.5, -0.5]"]), load())


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("evaluation.speeds=[0.0]", "evaluation.speeds: expected a number greater than 0, found 0."),
        ("evaluation.speeds=[0.5, -0.8]", "evaluation.speeds: expected a number greater than 0, found -0.8."),
        ("simulation_test.speeds=[0]", "simulation_test.speeds: expected a number greater than 0, found 0."),
        ("evaluation.speed_tolerance=10", "evaluation.speed_tolerance: expected a share below 1, found 10."),
        ("simulation_test.speed_tolerance=1", "simulation_test.speed_tolerance: expected a share below 1, found 1."),
    ],
)
def test_a_robot_that_follows_a_velocity_is_judged_at_speeds_above_0_within_a_share_of_them(override, words):
    with pytest.raises(ConfigError) as caught:
        check_names(config(objectives=["power"], robot="go1", world="twin", overrides=[override]), load())
    assert str(caught.value).startswith(words) and "\n" not in str(caught.value)


def test_another_task_has_its_own_use_for_the_tolerance():
    overrides = ["evaluation.speed_tolerance=10", "simulation_test.speed_tolerance=10"]
    check_names(config(overrides=overrides), load())


def test_a_preset_that_holds_the_speed_does_not_for_a_task_that_cannot(monkeypatch):
    holding = {part: {**PRESETS["smoke"][part], "hold_speed": True} for part in ("simulation_test", "evaluation")}
    several = {"selection": {**PRESETS["smoke"]["selection"], "speeds": [0.5, 1.1]}}
    monkeypatch.setitem(PRESETS, "smoke", {**PRESETS["smoke"], **holding, **several})
    found = config()
    check_names(found, load())
    assert found.selection.tested_speeds == (0.4,)
    assert not found.evaluation.hold_speed and not found.simulation_test.hold_speed
    walks = config(objectives=["power"], robot="go1", world="twin")
    assert walks.evaluation.hold_speed and walks.simulation_test.hold_speed
    assert walks.selection.tested_speeds == (0.5, 1.1)


def test_a_command_is_a_velocity_or_a_set_point_and_a_velocity_is_written_as_ever():
    walk = Command(seconds=2, vx=0.5)
    assert walk.model_dump() == {"seconds": 2.0, "vx": 0.5, "vy": 0.0, "yaw_rate": 0.0}
    for point in (0.4, None):
        command = Command.model_validate({"seconds": 2, "set_point": point})
        assert command.model_dump(mode="json") == {"seconds": 2.0, "set_point": point}
        assert command.commanded == (point or 0.0) and not command.is_velocity
        assert Command.model_validate(command.model_dump()) == command
    with pytest.raises(ValueError, match="vx"):
        Command.model_validate({"seconds": 2})
    with pytest.raises(ValueError, match="stands instead of a velocity, found vx"):
        Command.model_validate({"seconds": 2, "set_point": 0.4, "vx": 1.0})


# --------------------------------------------------------------------------------------------------- worlds


def test_no_world_says_that_it_holds_what_the_task_cannot(tmp_path):
    world = make_field({}, WorldContext("crane", {}, {"thrift": {}}, 0, tmp_path))
    assert world.hold_speed(HoldSpeed((0.1, 1.0))) is False
    assert world.head_to_head_seconds() == 4 * 80.0  # nothing is trimmed


def test_the_field_asks_for_the_set_point_and_not_for_a_speed(tmp_path, policy):
    context = WorldContext("crane", {}, {"thrift": {}}, 0, tmp_path)
    world = make_field({"block_seconds": 5.0}, context)
    with pytest.raises(WaitingForRobot):
        world.head_to_head(policy, policy, (0.4, 0.8))
    (bundle,) = (path for path in (tmp_path / "field").iterdir() if path.is_dir())
    text = (bundle / "README.md").read_text()
    assert "0.4 m for 5 s" in text and "| set-point |" in text and "m/s" not in text and "walk" not in text
    assert '"set_point": 0.8' in (bundle / "plan.json").read_text()


def test_a_bundle_of_a_robot_without_a_runtime_says_what_its_runner_has_to_do(tmp_path, policy, crane):
    world = make_field({"block_seconds": 5.0}, WorldContext("crane", {}, {"thrift": {}}, 0, tmp_path))
    with pytest.raises(WaitingForRobot):
        world.head_to_head(policy, policy, (0.4,))
    (bundle,) = (path for path in (tmp_path / "field").iterdir() if path.is_dir())
    text, spec = (bundle / "README.md").read_text(), crane.Crane.spec
    assert "The package of the robot 'crane' brings no runtime" in text
    assert "does the rows by itself" not in text and "then step 3" not in text  # which would be true of another robot
    assert f"**Loop.** {spec.control_rate_hz:g} times a second, each 50 ms" in text
    assert "`observation`, float32 (1, 2), and gives `action`, float32 (1, 1)." in text
    assert (
        "| 0 | 0 | hook_height | see there | as the robot's env in its package writes it |\n| 1 | 1 | wanted |" in text
    )
    assert "What an action does is what the env in the robot's package makes of it" in text  # here it is a speed, m/s
    assert "| winch | 0 | 1 | 0 | 0 | -10 to 10 | 10 | 1 |" in text
    assert "damping" in text and "trunk" not in text and "legs" not in text


@pytest.mark.parametrize(
    ("set_points", "words"),
    [((), "each elite gets one."), ((0.4, 0.8), "each set-point gets one of its own.")],
)
def test_head_to_heads_that_are_not_shared_are_told_in_the_words_of_the_task(set_points, words):
    from hts.contracts import Task
    from hts.contracts.task import VELOCITY
    from hts.run.testing_elites import one_for_each

    class Own(Task):
        quantity, unit, channels = "hook height", "m", ("hook_height",)

        def achieved(self, channels):
            return channels["hook_height"]

        def done(self, achieved, set_point, tolerance):
            return True

    Own.set_points = set_points
    assert one_for_each(Own()) == words
    assert one_for_each(VELOCITY) == "each speed gets one of its own."


def test_a_twin_refuses_it(tmp_path):
    from hts.worlds.twin.process import Twin

    start = {"settings": {}, "robot": "crane", "robot_settings": {}, "objectives": {}, "seed": 0, "name": "twin"}
    with pytest.raises(UnfitWorldError, match="robot 'crane' has another task"):
        Twin({**start, "spool": str(tmp_path / "spool.zarr")}).check()


def test_a_schedule_of_set_points_is_kept_in_a_store(tmp_path, crane, policy):
    from hts.recordings.store import RecordingStore

    schedule = ScheduleConfig(commands=tuple(crane.HoldHeight().command(point, 2.0) for point in (0.4, 0.8)))
    (recording,) = crane.Yard().collect([policy], schedule)
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    assert store.read(store.write(recording)).schedule == schedule


@pytest.mark.parametrize(
    ("achieved", "share", "does"), [(0.52, 0.9, True), (0.52, 0.5, True), (0.5, 0.45, False), (0.6, 0.9, False)]
)
def test_a_mean_speed_made_of_standing_and_hurrying_is_no_speed_kept(achieved, share, does):
    from hts.contracts.task import VELOCITY

    assert VELOCITY.does_it(achieved, share, 0.5, 0.1) is does
