"""Every hook has a heading with its exact signature, one example and one test: the tests, and what enforces this."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from hts import hookspecs
from hts.channels import Channel
from hts.config import Named
from hts.contracts import (
    Comparison,
    LogOnlyRobot,
    ModelContext,
    PhysicsSample,
    RobotSpec,
    SimulatedCandidate,
    TestedCandidate,
)
from hts.errors import ConfigError, RecordingError, WorldError
from hts.measurement.data import input_tensor
from hts.plugins import KINDS, Registry, load
from hts.testing.conformance import check_package
from hts.testing.known_signals import SIGNALS, known_heat
from hts.testing.made_up_recordings import known_head_to_head

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs/authors/hooks.md"
BLOCK = re.compile(r'^```python title="(\w+)\.py"\n(.*?)^```$', re.MULTILINE | re.DOTALL)


def hooks(module: ModuleType | SimpleNamespace) -> dict[str, str]:
    """Name of every hook of a module of hook specifications -> name(parameters), as its heading must say."""
    found = {name: value for name, value in vars(module).items() if hasattr(value, "hts_spec")}
    return {name: f"{name}{inspect.signature(value)}" for name, value in found.items()}


def faults(text: str, module: ModuleType | SimpleNamespace, tests: set[str]) -> list[str]:
    """What a page of hooks lacks, one line each."""
    wanted = hooks(module)
    parts = re.split(r"^## (.*)$", text, flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    result = []
    for heading in sections:
        name = heading.partition("(")[0]
        if name.startswith("hts_") and wanted.get(name) != heading:
            expected = f"the signature is {wanted[name]}" if name in wanted else "there is no such hook"
            result.append(f"heading {heading}: {expected}")
    for name, signature in wanted.items():
        examples = BLOCK.findall(sections.get(signature, ""))
        if signature not in sections:
            result.append(f"no heading {signature}")
        elif len(examples) != 1:
            result.append(f"{name}: {len(examples)} examples, expected 1")
        elif f"@hookimpl\ndef {signature}:" not in examples[0][1] or "\nHTS_API = " not in examples[0][1]:
            result.append(f"{name}: its example is no whole module that implements {signature}")
        if f"test_hook_{name.removeprefix('hts_')}" not in tests:
            result.append(f"{name}: no test test_hook_{name.removeprefix('hts_')}")
    return result


# --------------------------------------------------------------------------------------------------- enforcement


def test_every_hook_has_its_heading_its_example_and_its_test():
    assert faults(PAGE.read_text(), hookspecs, set(globals())) == []
    assert set(hooks(hookspecs)) == {f"hts_{kind}" for kind in KINDS}


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("## hts_selectors(register)", "## Selectors", "no heading hts_selectors(register)"),
        (
            "## hts_robots(register)",
            "## hts_robots(register, old)",
            "heading hts_robots(register, old): the signature is",
        ),
        (
            "# Hook reference\n",
            "# Hook reference\n## hts_robot(register)\n",
            "heading hts_robot(register): there is no such",
        ),
        (
            "@hookimpl\ndef hts_worlds(register):",
            "def hts_worlds(register):",
            "hts_worlds: its example is no whole module",
        ),
        ('```python title="ammeter.py"', "```text", "hts_instruments: 0 examples, expected 1"),
    ],
)
def test_a_page_that_has_fallen_behind_is_noticed(old, new, fault):
    text = PAGE.read_text()
    assert old in text
    assert any(line.startswith(fault) for line in faults(text.replace(old, new), hookspecs, set(globals())))


def test_a_hook_that_nobody_described_or_tested_is_noticed():
    @hookspecs.hookspec
    def hts_gaits(register, again=False):
        """A hook of tomorrow."""

    tomorrow = SimpleNamespace(**vars(hookspecs), hts_gaits=hts_gaits)
    assert faults(PAGE.read_text(), tomorrow, set(globals())) == [
        "no heading hts_gaits(register, again=False)",
        "hts_gaits: no test test_hook_gaits",
    ]


# ------------------------------------------------------------------------------------------------- the examples


@pytest.fixture
def example(install):
    """example("hts_worlds"): the registry with the example of that hook installed as a package."""

    def loaded(hook: str) -> Registry:
        text = PAGE.read_text()
        ((module, code),) = BLOCK.findall(text[text.index(f"## {hook}(") :].split("\n## ")[0])
        install("hts-example", {module: code}, {"example": module})
        registry = load()
        assert [one.reason for one in registry.broken if one.package == "hts-example"] == []
        return registry

    return loaded


def exported(robot: str, folder: Path) -> Path:
    """An exported policy for whatever, known by its hash alone."""
    from hts.policies.export import to_onnx
    from hts.policies.files import Policy, make_card
    from hts.rl.population import Population, Sizes

    spec = load().make_robot(robot).spec
    sizes = Sizes(2, 2, spec.num_joints, (4,))
    tensors = Population(sizes, 1).candidate(0)
    return to_onnx(
        Policy(tensors, make_card(spec, tensors, [{"name": "all", "size": 2}], sizes)), folder / "policy.onnx"
    )


def test_hook_objectives(example):
    registry = example("hts_objectives")
    objective = registry.make_objective("current", {"hidden": 8})
    assert objective.measurement_model() == Named(name="lstm", hidden=8)
    assert objective.compare({"current": 3.0}, {"current": 5.0}).improvement == 2.0
    with pytest.raises(ConfigError, match="objective 'current' .from hts-example.*Did you mean 'hidden'"):
        registry.make_objective("current", {"hiden": 8})


def test_hook_measurement_models(example):
    registry = example("hts_measurement_models")
    model = registry.make_measurement_model("slow", {"hidden": 8}, ModelContext(SIGNALS))
    assert (model.name, model.settings["sequence"], model.settings["hidden"]) == ("slow", 250, 8)
    model.fit([known_heat(1, seconds=12.0)], epochs=1)
    assert model.step(input_tensor(SIGNALS, known_heat(2))[:3], model.initial_state(3))[0].mean.shape == (3,)
    with pytest.raises(ConfigError, match="measurement model 'slow' .from hts-example.*Did you mean 'hidden'"):
        registry.make_measurement_model("slow", {"hiden": 8}, ModelContext(SIGNALS))


def test_hook_robots(example):
    robot = example("hts_robots").make_robot("pendulum")
    assert robot.spec.num_joints == 1 and robot.mjcf() is None
    assert robot.channels()["joint_torque"].shape == (1,)
    assert [one.line() for one in check_package(load(), "hts-example") if one.fault] == []


def test_hook_worlds(example, tmp_path):
    from hts.policies.deploy import DeployedPolicy
    from hts.recordings import RecordingStore

    pytest.importorskip("hts_go1", reason="the policy of this test is for its robot")
    registry = example("hts_worlds")
    policy = exported("go1", tmp_path)
    own = DeployedPolicy(policy).card.policy_hash
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    for recording in known_head_to_head(8.0, 10.0, idle=2.0):
        varying = recording.channels["cost"].values
        varying += 0.01 * np.arange(len(varying))  # a sensor that shows one number would be refused
        store.write(recording.replace(policy_hash=own) if recording.role == "policy" else recording)
    world = registry.make_world("archive", {"store": str(tmp_path / "data.zarr")}, None)
    assert world.idle() == {"cost": 2.0}
    with pytest.raises(WorldError, match="no recording of this policy"):
        world.collect([policy], None)
    assert [one.role for one in world._of(policy, ("policy",))] == ["policy", "policy"]


def test_hook_instruments(example):
    registry = example("hts_instruments")
    meter = registry.make_instrument("ammeter", {"per_torque": 0.5}, None)
    meter.reset(2, np.random.default_rng(0))
    torque, nothing = np.array([[1.0, -3.0], [0.0, 0.0]]), np.zeros((2, 2))
    meter.step(PhysicsSample(torque, nothing, nothing, nothing, nothing, dt=0.001))
    assert meter.read()["supply_current"].tolist() == [1.5 + 0.5 * 4.0, 1.5]
    assert meter.idle() == {"supply_current": 1.5}


def test_hook_selectors(example):
    selector = example("hts_selectors").make_selector("careful", {"least": 0.1})
    candidates = [SimulatedCandidate("fell", 9.0, 1, True), SimulatedCandidate("a", 1.0, 0, True)]
    assert selector.elites([*candidates, SimulatedCandidate("b", 2.0, 0, True)], 2) == ["b", "a"]

    def tested(name: str, gain: float) -> TestedCandidate:
        return TestedCandidate(name, {"x": Comparison(gain, gain)}, False)

    assert selector.best([tested("a", 0.05), tested("b", 0.2)]) == "b"
    assert selector.best([tested("a", 0.05)]) is None


def test_hook_log_readers(example, tmp_path):
    registry = example("hts_log_readers")
    reader = registry.make_log_reader("jsonl")
    robot = LogOnlyRobot(
        RobotSpec.log_only(
            "one", ("j",), torque_limit=(5,), velocity_limit=(9,), position_limit=((-1, 1),), rate_hz=100.0
        ),
        [Channel("joint_torque", "N*m", (1,))],
    )
    log = tmp_path / "walk.jsonl"
    rows = [{"t": 0.01 * i, "tau": 0.1 * i, "current": 2.0 + i} for i in range(5)]
    log.write_text("\n".join(map(json.dumps, rows)))
    channels = {
        "joint_torque": {"columns": "tau", "unit": "N*m"},
        "supply_current": {"columns": "current", "unit": "A", "idle": 1.9},
    }
    mapping = {"reader": "jsonl", "time": {"column": "t", "unit": "s"}, "rate_hz": 100.0, "channels": channels}
    recording = reader.read([log], mapping, robot)
    assert recording.values("supply_current").tolist() == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert recording.idle == {"supply_current": 1.9}
    log.write_text("t,tau\n")
    with pytest.raises(RecordingError, match="walk.jsonl: not a log that the reader 'jsonl' knows"):
        reader.read([log], mapping, robot)
    assert [one.line() for one in check_package(registry, "hts-example") if one.fault] == []


def test_hook_commands(example, tmp_path):
    from typer.testing import CliRunner

    from hts.cli.group import hts_group
    from hts.recordings import RecordingStore

    registry = example("hts_commands")
    assert registry.commands["count-recordings"].package == "hts-example"
    RecordingStore(tmp_path / "data.zarr", create=True)
    function = registry.commands["count-recordings"].factory()
    import typer

    app = typer.Typer()
    app.command()(function)
    done = CliRunner().invoke(app, [str(tmp_path / "data.zarr")])
    assert (done.exit_code, done.stdout.strip()) == (0, "0")
    assert "count-recordings" in hts_group().list_commands(None)
