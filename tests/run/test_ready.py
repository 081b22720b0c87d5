"""A dry run builds everything that a run will build, so what cannot work is one line before anything is spent."""

from __future__ import annotations

import re

import pytest

from hts.config_loading import load_config
from hts.errors import ConfigError, HtsError, PluginError, PolicyError, UnfitWorldError
from hts.plugins import load
from hts.run.ready import check_ready
from hts.testing.packages import kit_installed

OBJECTIVE = """
from hts import hookimpl
from hts.testing.examples.objective.objective import Fake

HTS_API = {api}

class Broken(Fake):
    name = "broken"
{body}

@hookimpl
def hts_objectives(register):
    register("broken", lambda settings: Broken())
"""


@pytest.fixture(autouse=True)
def _kit():
    with kit_installed():
        yield


def check(objective="fake", world="known", robot="tiny", engine="mujoco", *overrides):
    sets = (f"sweep.weights.{objective}=[1.0]", *overrides)
    config = load_config(preset="smoke", objectives=[objective], robot=robot, world=world, overrides=sets)
    check_ready(config, load(), engine)


def refusal(kind: type[HtsError], *given, **named) -> str:
    with pytest.raises(kind) as caught:
        check(*given, **named)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def broken(install):
    """broken(body): an objective with this body in its class."""
    from hts.hookspecs import API_VERSION

    def make(body: str) -> None:
        text = OBJECTIVE.format(api=API_VERSION, body="\n".join("    " + line for line in body.splitlines()))
        install("stranger", {"stranger": text}, {"stranger": "stranger"})

    return make


def test_a_run_that_can_work_passes():
    check()


@pytest.mark.parametrize("world", ["twin", "field"])
def test_a_run_of_the_kits_robot_in_the_cores_worlds_passes(world):
    check(world=world)


def test_a_measurement_model_that_cannot_be_made_is_told_with_its_package(broken):
    broken("def measurement_model(self):\n    return {}['hidden']")
    text = refusal(PluginError, "broken")
    assert text.startswith("Objective 'broken' (from stranger): measurement_model() failed, KeyError: 'hidden'")


def test_an_objective_that_reads_what_the_robot_does_not_give_is_told(broken):
    broken("inputs = ('joint_torqe', 'joint_velocity')")
    assert "Did you mean 'joint_torque'?" in refusal(ConfigError, "broken")


def test_a_reward_that_cannot_be_computed_is_told(broken):
    broken("def reward(self, prediction):\n    return prediction.no_such_method()")
    assert "no_such_method" in refusal(PluginError, "broken")


def test_a_reward_that_pays_for_what_counts_as_worse_is_told(broken):
    broken("def reward(self, prediction):\n    return prediction")
    text = refusal(PluginError, "broken")
    assert text.startswith("Objective 'broken': reward() pays for more of 'fake_level', compare() counts less of it as")


def test_two_objectives_that_measure_one_channel_in_two_units_are_told():
    from hts.channels import Channel
    from hts.run.ready import check_shared_channels
    from hts.testing.made_up_recordings import CostObjective

    one, other, third = CostObjective(), CostObjective(), CostObjective()
    other.also_measured = (Channel("supply", "V"),)
    third.also_measured = (Channel("supply", "mV"),)
    check_shared_channels({"one": one, "other": other, "again": other})
    with pytest.raises(ConfigError, match=r"'other' and 'third' both measure 'supply', one in V, the other in mV;"):
        check_shared_channels({"one": one, "other": other, "third": third})


def test_an_objective_without_an_instrument_has_no_twin(broken):
    broken("instrument = None")
    text = refusal(UnfitWorldError, "broken", "twin")
    assert "names no instrument" in text and "start a run in another world: --world " in text
    offered = text.split("--world ")[1].rstrip(".").split(" or ")
    assert offered == sorted(set(load().worlds) - {"twin"}) and "field" in offered


def test_an_instrument_that_measures_something_else_is_told(broken):
    broken("from hts.channels import Channel\ntarget = Channel('other', 'W')")
    assert "wants 'other'" in refusal(UnfitWorldError, "broken", "twin")


def test_a_robot_without_a_model_has_no_twin(install, tmp_path):
    from hts.hookspecs import API_VERSION
    from hts.testing.tiny_policy import write_drive_policy

    text = (
        "from dataclasses import replace\nfrom pathlib import Path\n"
        f"from hts import hookimpl\nfrom hts.testing.examples.robot.robot import Tiny\nHTS_API = {API_VERSION}\n"
        "class Bare(Tiny):\n    spec = replace(Tiny.spec, name='bare')\n    def mjcf(self):\n        return None\n"
        "    def pretrained_policy(self):\n"
        f"        return Path({str(tmp_path / 'bare.safetensors')!r})\n"
        "@hookimpl\ndef hts_robots(register):\n    register('bare', lambda settings: Bare())\n"
    )
    write_drive_policy(tmp_path / "bare.safetensors", "bare")
    install("stranger", {"stranger": text}, {"stranger": "stranger"})
    assert "has no model" in refusal(UnfitWorldError, robot="bare", world="twin")


def test_a_policy_file_that_is_not_there_is_told(install, tmp_path):
    from hts.hookspecs import API_VERSION

    text = (
        "from dataclasses import replace\nfrom pathlib import Path\n"
        f"from hts import hookimpl\nfrom hts.testing.examples.robot.robot import Tiny\nHTS_API = {API_VERSION}\n"
        "class Lost(Tiny):\n    spec = replace(Tiny.spec, name='lost')\n    def pretrained_policy(self):\n"
        f"        return Path({str(tmp_path / 'none.safetensors')!r})\n"
        "@hookimpl\ndef hts_robots(register):\n    register('lost', lambda settings: Lost())\n"
    )
    install("stranger", {"stranger": text}, {"stranger": "stranger"})
    assert "none." in refusal(PolicyError, robot="lost")


def test_a_mapping_of_the_field_that_lacks_a_channel_is_told(tmp_path):
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text("reader: csv\nchannels: {joint_torque: {columns: tau, unit: N*m}}\n")
    text = refusal(ConfigError, "fake", "field", "tiny", "mujoco", f"world.mapping={mapping}")
    assert text.startswith(f"{mapping}: objective 'fake' needs ")
    mapping.unlink()
    assert "mapping.yaml" in refusal(ConfigError, "fake", "field", "tiny", "mujoco", f"world.mapping={mapping}")


def test_warp_without_cuda_ends_a_dry_run(hts, monkeypatch):
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("needs a machine without CUDA; the CPU machines of CI are such")
    done = hts("run", "--objective", "fake", "--robot", "tiny", "--world", "known", "--engine", "warp", "--dry-run")
    assert done.returncode == 2 and re.search("needs (a working )?CUDA", done.stderr) and done.stderr.count("\n") == 1


def test_what_only_another_world_can_cure_does_not_send_anybody_to_resume(tmp_path):
    from hts.cli.one_line import resumable

    (tmp_path / "config.yaml").write_text("")
    with pytest.raises(UnfitWorldError) as caught, resumable(tmp_path):
        raise UnfitWorldError("No twin of it. Start a run in another world: --world field.")
    assert "resume" not in str(caught.value)


# -------------------------------------------------------------------------------------------- scores and instruments


@pytest.mark.parametrize(
    ("score", "said"),
    [
        (
            "{'net': segments.values('fake_levl').mean(axis=1)}",
            "No channel named 'fake_levl'. Did you mean 'fake_level'?",
        ),
        ("{'net': segments.idle('fake_levl')}", "has no idle level of 'fake_levl'"),
        ("{'net': segments.valeus('fake_level')}", "AttributeError: 'Segments' object has no attribute 'valeus'"),
        ("{'net': segments.values('fake_level').mean()}", "score 'net' has shape () for 3 segments"),
        ("segments.values('fake_level').mean(axis=1)", "gives a ndarray, expected names with arrays"),
        ("{'net': segments.values('fake_level') - segments.idle('fake_level')}", "ValueError: operands could not be"),
        ("{}", "score gives no quantity of the segments"),
        ("{'net': ['a', 'b', 'c']}", "score 'net' holds a list that is no array of numbers"),
    ],
)
def test_a_score_that_cannot_be_made_is_found_before_anything_is_recorded(broken, score, said):
    broken(f"def score(self, segments):\n    return {score}")
    found = refusal(PluginError, "broken")
    assert said in found and "Objective 'broken' (from stranger): score" in found


@pytest.mark.parametrize(
    ("compare", "said"),
    [
        ("policy['nett']", r"compare fails on what score gives, {.*}, KeyError: 'nett'"),
        ("Comparison(None, 0.0)", r"compare() gave 'improvement' as None, a NoneType; expected one number"),
        ("Comparison(0.0, 0.0, {'x': 'much'})", "compare() gave 'x' as 'much', a str; expected one number"),
        ("Comparison(0.0, 0.0, {'x': np.ones(2)})", "compare() gave 'x' as array([1., 1.]), a ndarray; expected one"),
        ("Comparison(0.0, 0.0, 3)", "metrics that are a int, expected names with numbers"),
        ("{'improvement': 1.0}", "compare() gave dict, expected Comparison"),
    ],
)
def test_a_comparison_that_is_no_numbers_is_found_before_anything_is_recorded(broken, compare, said):
    broken(
        "def compare(self, policy, reference):\n    import numpy as np\n    from hts.contracts import Comparison\n"
        f"    return {compare}"
    )
    found = refusal(PluginError, "broken")
    assert re.search(said, found) or said in found
    assert found.startswith("Objective 'broken'")


def test_numbers_of_numpy_and_torch_become_plain_ones():
    import json

    import numpy as np
    import torch

    from hts.contracts import Comparison
    from hts.evaluation.scoring import plain
    from hts.testing.examples.objective.objective import Fake

    found = plain(Fake(), Comparison(np.float32(0.5), torch.tensor(0.25), {"x": np.int64(3), "y": np.array(1.5)}))
    assert json.dumps(vars(found)) == '{"improvement": 0.5, "selection_score": 0.25, "metrics": {"x": 3.0, "y": 1.5}}'


def test_a_score_may_refuse_numbers_that_nobody_measured(broken):
    broken("def score(self, segments):\n    raise ValueError('no such numbers')")
    check("broken")


SENSOR = """
from dataclasses import replace
from hts import hookimpl
from hts.testing.examples.objective.meter import Meter as Sound
from hts.testing.examples.objective.objective import TARGET, Fake

HTS_API = {api}

class Meter(Sound):
    channels = ({channel},)

    def read(self):
        return {read}

    def idle(self):
        return {idle}

class Broken(Fake):
    name, instrument = "broken", "odd_meter"
    target = {target}

    def score(self, segments):
        level = segments.values(TARGET.name)
        return {{"net": level.reshape(len(segments), -1).mean(1), "gross": level.reshape(len(segments), -1).mean(1)}}

@hookimpl
def hts_objectives(register):
    register("broken", lambda settings: Broken())

@hookimpl
def hts_instruments(register):
    register("odd_meter", lambda settings, robot: Meter())
"""
OF_ONE = "replace(TARGET, shape=(1,))"


@pytest.mark.parametrize(
    ("channel", "target", "read", "said"),
    [
        (
            *(OF_ONE, OF_ONE, "super().read()"),
            "Instrument 'odd_meter': read() gives 'fake_level' in shape (3,) for 3 robots; its channel says (1,) each",
        ),
        (
            *("TARGET", OF_ONE, "super().read()"),
            "Objective 'broken' wants 'fake_level' in W, shape (1,); instrument 'odd_meter' measures it in W, shape ()",
        ),
        (
            *("TARGET", "TARGET", "{'fake_levl': self.level}"),
            "Instrument 'odd_meter': read() gives no 'fake_level', only fake_levl",
        ),
        (
            *("TARGET", "TARGET", "{'fake_level': self.level[[0, 0, 0]]}"),
            "Instrument 'odd_meter': read() gives 'fake_level' in shape (3,) for 1 robot; its channel says () each",
        ),
        (
            *("TARGET", "TARGET", "{'fake_level': self.levl}"),
            "Instrument 'odd_meter': reading it failed, AttributeError",
        ),
    ],
)
def test_a_sensor_that_cannot_be_read_is_found_before_a_robot_walks(install, channel, target, read, said):
    from hts.hookspecs import API_VERSION
    from hts.testing.packages import on_path

    source = SENSOR.format(api=API_VERSION, channel=channel, target=target, read=read, idle="super().idle()")
    with on_path(install("stranger", {"stranger": source}, {"stranger": "stranger"})):
        assert said in refusal(HtsError, "broken", "twin")


@pytest.mark.parametrize(
    ("idle", "said"),
    [
        ("{}", "idle() gives no level of 'fake_level', only nothing, and objective 'broken' needs it"),
        (
            "{'fake_levl': 9.0}",
            "idle() gives no level of 'fake_level', only fake_levl, and objective 'broken' needs it",
        ),
        (
            "{'fake_level': 9.0, 'other': 1.0}",
            "idle() gives a level of 'other', which is no channel of it (fake_level)",
        ),
        ("{'fake_level': None}", "idle() gives None for 'fake_level', expected a finite number"),
        ("{'fake_level': float('nan')}", "idle() gives nan for 'fake_level', expected a finite number"),
        ("None", "idle() gives NoneType, expected the level of each channel by name"),
        ("{'fake_level': self.levl}", "idle() failed, AttributeError"),
    ],
)
def test_a_sensor_without_an_idle_level_is_found_before_a_robot_walks(install, idle, said):
    from hts.hookspecs import API_VERSION
    from hts.testing.packages import on_path

    source = SENSOR.format(api=API_VERSION, channel="TARGET", target="TARGET", read="super().read()", idle=idle)
    with on_path(install("stranger", {"stranger": source}, {"stranger": "stranger"})):
        assert f"Instrument 'odd_meter': {said}" in refusal(HtsError, "broken", "twin")


@pytest.mark.parametrize("key", ["finetune.env.randomisation.added_mass", "gate.payload"])
def test_a_trunk_that_would_weigh_nothing_is_one_line_with_its_key_and_mass(key):
    check("fake", "known", "tiny", "mujoco", f"{key}=[-1.0, 1.0]")
    said = refusal(ConfigError, "fake", "known", "tiny", "mujoco", f"{key}=[-20.0, 1.0]")
    where = key.removeprefix("finetune.env.")
    assert said.startswith(where) and ": -20 kg would leave nothing of the trunk of 'tiny'" in said
    assert re.search(r"which weighs [\d.]+ kg\. Raise the lower end\.$", said)


def test_a_baseline_without_a_stand_in_is_not_told_to_name_weights_for_it(broken):
    broken("baseline_weights = ()\n\ndef proxy(self, channels):\n    return None")
    config = load_config(
        preset="smoke", objectives=["broken"], robot="tiny", world="known", overrides=["reward_source=proxy"]
    )
    with pytest.raises(ConfigError, match=r"^Objective 'broken' has no analytic stand-in.*Write its `proxy`"):
        check_ready(config, load())
