"""A model written down as operations: what a reader without hts makes of the file is what hts gives in its env."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from hts.cli.main import main
from hts.contracts import MeasurementModel, ModelContext, Prediction
from hts.errors import ConfigError, PolicyError, RunError
from hts.measurement import files, operations
from hts.measurement.export import export_model
from hts.measurement.export_command import export_measurement_model
from hts.measurement.torch_model import TorchModel
from hts.measurement.transform import MeasurementTransform
from hts.plugins import load
from hts.testing.known_signals import SIGNALS, KnownHeat, known_heat

INTEGRATION = Path(__file__).resolve().parents[2] / "integrations" / "rsl_rl"


@pytest.fixture
def reader(monkeypatch):
    """The package of those who stay with rsl_rl, from where it lies."""
    monkeypatch.syspath_prepend(str(INTEGRATION))
    yield importlib.import_module("hts_rsl_rl.measurement")
    for name in [name for name in sys.modules if name.split(".")[0] == "hts_rsl_rl"]:
        del sys.modules[name]


def fitted(name: str, **settings) -> MeasurementModel:
    model = load().make_measurement_model(name, settings, ModelContext(SIGNALS))
    model.fit([known_heat(1, seconds=6.0), known_heat(2, seconds=6.0)], epochs=1)
    return model


class Tcn(TorchModel):
    """A small causal convolution in time, each layer dilated twice as far as the one before; its memory is the past."""

    def __init__(self) -> None:
        super().__init__(SIGNALS, False)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            kinds = ((self.num_features, 8, 1), (8, 8, 4), (8, 4, 1))
            self.layers = torch.nn.ModuleList(
                torch.nn.Conv1d(one, other, 2, dilation=2**level, groups=groups)
                for level, (one, other, groups) in enumerate(kinds)
            )
            self.head = torch.nn.Conv1d(4, 1, 1, bias=False)
        self.set_statistics(torch.tensor([[-1.0] * 6, [2.0] * 6]), torch.tensor([1.0, 3.0]))
        self.requires_grad_(False)

    @property
    def settings(self):
        return {}

    def learn(self, recordings, how):
        return {}

    def initial_state(self, num_worlds):
        return torch.zeros(num_worlds, 7, self.num_features, device=self.device)

    def sequence(self, inputs, state=None):
        before = self.initial_state(len(inputs)) if state is None else state
        whole = torch.cat([before, self.scaled_features(inputs)], 1)
        seen = whole.transpose(1, 2)
        for layer in self.layers:
            seen = layer(seen).relu()
        return Prediction(self.head(seen)[:, 0] + 0 * inputs.sum(-1)), whole[:, -7:]

    def step(self, inputs, state):
        prediction, after = self.sequence(inputs[:, None], state)
        return Prediction(prediction.mean[:, 0]), after


def in_env(model: MeasurementModel, inputs: torch.Tensor, ended: torch.Tensor) -> dict[str, torch.Tensor]:
    """What the transform writes in an env of one candidate: inputs (T, W, F), ended (T, W)."""
    transform, rows = MeasurementTransform.of(KnownHeat(), model), []
    transform.prepare(inputs.shape[1], torch.device("cpu"))
    for now, over in zip(inputs, ended, strict=True):
        rows.append([value.squeeze(-1) for value in transform.evaluate(now).values()])
        transform.forget(over)
    return dict(zip(("measured", "reward", "outside"), map(torch.stack, zip(*rows, strict=True)), strict=True))


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("linear", {}),
        ("lstm", {"hidden": 8, "layers": 2, "products": True}),
        ("ensemble", {"members": 2, "member": {"name": "lstm", "hidden": 4}}),
    ],
)
def test_a_reader_without_hts_gives_what_the_env_gives(name, settings, tmp_path, reader):
    gives_what_the_env_gives(fitted(name, **settings), name, tmp_path, reader)


def test_a_convolution_in_time_is_written_down_too(tmp_path, reader):
    gives_what_the_env_gives(Tcn(), "Tcn", tmp_path, reader)


def gives_what_the_env_gives(model: MeasurementModel, name: str, tmp_path: Path, reader) -> None:
    """Raises AssertionError if a reader of the model's file gives something else than the model in an env of hts."""
    path = export_model(model, KnownHeat(), tmp_path / "m.safetensors", joint_names=("x", "y", "z"))
    read = reader.MeasurementModel(path)
    assert (read.name, read.objective, read.rate_hz, read.joint_names) == (name, "cool", 50.0, ("x", "y", "z"))
    assert [(one.name, one.unit, one.shape) for one in read.inputs] == [
        (one.name, one.unit, one.shape) for one in SIGNALS.inputs
    ]
    for worlds in (1, 5):
        random = torch.Generator().manual_seed(worlds)
        inputs = 1.5 * torch.randn(40, worlds, 6, generator=random)
        ended = torch.rand(40, worlds, generator=random) < 0.1
        wanted, state = in_env(model, inputs, ended), read.initial_state(worlds)
        for index, now in enumerate(inputs):
            seen, state = read.step(now, state)
            for key, value in seen._asdict().items():
                torch.testing.assert_close(value, wanted[key][index], atol=1e-5, rtol=1e-5)
            state = read.reset(state, ended[index])
        assert wanted["outside"].max() > 0
    assert read.in_units(torch.zeros(())) == pytest.approx(float(model.target_mean))
    broken, _ = read.step(torch.full((1, 6), torch.nan), read.initial_state(1))
    assert not torch.isfinite(broken.reward).any()  # a NaN never becomes a reward
    with safe_open(path, "pt") as file:
        card = json.loads(file.metadata()["hts"])
    asked = {operation[0] for program in card["programs"].values() for operation in program["operations"]}
    assert asked <= operations.ALLOWED | set(operations.INTEGERS.values())


def test_what_may_be_written_is_what_may_be_read(reader):
    program = importlib.import_module("hts_rsl_rl.program")
    assert set(program.OPERATIONS) == operations.ALLOWED | set(operations.INTEGERS.values())
    assert set(program.DTYPES) == set(operations.DTYPES.values())


class Odd(MeasurementModel):
    """A model with the fault that a test wants: a number that depends on how many worlds there are, a reset that leads
    elsewhere, or an operation that no file may name."""

    name, signals, settings = "odd", SIGNALS, {}

    def __init__(self, fault: str) -> None:
        self.fault, self.target_mean, self.target_std = fault, torch.tensor(0.0), torch.tensor(1.0)

    def fit(self, recordings, **_):
        return {}

    def sequence(self, inputs, state=None):
        raise NotImplementedError

    def initial_state(self, num_worlds):
        return torch.zeros(num_worlds, 1)

    def reset(self, state, begun):
        return state if self.fault == "reset" else super().reset(state, begun)

    def step(self, inputs, state):
        mean = inputs.sum(-1)
        if self.fault == "worlds":
            mean = mean - mean.mean()
        if self.fault == "branch" and bool(mean.sum() > 0):
            mean = -mean
        return Prediction(torch.erfinv(mean) if self.fault == "operation" else mean), state

    def tensors(self):
        return {}

    def load_tensors(self, tensors):
        """There are none."""

    def to(self, device):
        return self


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("worlds", "off by"),
        ("reset", "does not lead back"),
        ("operation", "uses aten.erfinv"),
        ("branch", "cannot be written down"),
    ],
)
def test_a_model_that_would_be_another_one_in_the_file_is_not_written(fault, said, tmp_path):
    with pytest.raises(ConfigError, match=said) as error:
        export_model(Odd(fault), KnownHeat(), tmp_path / "m.safetensors")
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------------------------- the reader


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("exported") / "linear.safetensors"
    return export_model(fitted("linear"), KnownHeat(), path)


def changed(path: Path, to: Path, change) -> Path:
    """A copy with header and tensors as change(card, tensors) leaves them."""
    with safe_open(path, "pt") as file:
        card, tensors = json.loads(file.metadata()["hts"]), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    change(card, tensors)
    save_file(tensors, to, {"hts": json.dumps(card)})
    return to


def first(card):
    return card["programs"]["reward"]["operations"][0]


FAULTS = {
    "names the operation": lambda card, _: first(card).__setitem__(0, "os.system"),
    "'aten.from_file.default'": lambda card, _: first(card).__setitem__(0, "aten.from_file.default"),
    "there is not": lambda card, _: first(card)[1].__setitem__(0, {"value": 10**6}),
    "there is not. ": lambda card, _: first(card)[1].__setitem__(0, {"constant": "constant.99"}),
    "as an argument": lambda card, _: first(card)[1].__setitem__(0, "__import__('os')"),
    "would make": lambda card, _: card["programs"]["reward"]["operations"].insert(
        0, ["aten.full.default", [[10**6, 10**6], 0.0], {}]
    ),
    "sizes are whole numbers": lambda card, _: card["programs"]["reward"]["operations"].insert(
        0, ["int.mul", [[1], 10**9], {}]
    ),
    "more than 64 bits": lambda card, _: card["programs"]["reward"]["operations"].insert(
        0, ["int.mul", [2**40, 2**40], {}]
    ),
    "getitem takes one of several": lambda card, _: card["programs"]["reward"]["operations"].insert(
        0, ["getitem", [{"value": 0}, 0], {}]
    ),
    "format version 9": lambda card, _: card.__setitem__("version", 9),
    "no exported measurement model": lambda card, _: card.__setitem__("format", "other"),
    "KeyError": lambda card, _: card.pop("rate_hz"),
    "reference is incomplete": lambda _, tensors: tensors.__setitem__("reference.measured", torch.zeros(3)),
    "is off by": lambda _, tensors: tensors["constant.0"].mul_(1.01),
    "is off by nan": lambda _, tensors: tensors["constant.0"].fill_(torch.nan),
    "does not fit together": lambda _, tensors: tensors.__setitem__("constant.0", torch.zeros(3, 3)),
    "gives": lambda card, _: card["programs"]["reward"]["results"].pop(),
    "takes": lambda card, _: card["programs"]["reward"].__setitem__("arguments", ["state", "inputs"]),
}


@pytest.mark.parametrize("said", FAULTS)
def test_a_file_that_was_changed_is_refused_in_a_line_before_it_is_used(said, exported, tmp_path, reader):
    bad = changed(exported, tmp_path / "bad.safetensors", FAULTS[said])
    with pytest.raises(reader.ModelFileError) as error:
        reader.MeasurementModel(bad)
    assert said.strip() in str(error.value)
    assert "\n" not in str(error.value) and str(bad) in str(error.value)


def test_what_is_no_such_file_is_refused_in_a_line(tmp_path, reader):
    (tmp_path / "text.safetensors").write_text("\x1b[2J not a model")
    save_file({"a": torch.zeros(1)}, tmp_path / "other.safetensors")
    for name, said in (("missing", "no such file"), ("text", "not a safetensors file"), ("other", "no exported")):
        with pytest.raises(reader.ModelFileError, match=said) as error:
            reader.MeasurementModel(tmp_path / f"{name}.safetensors")
        assert "\n" not in str(error.value)


# ------------------------------------------------------------------------------------------------ the command


def test_the_command_writes_the_model_of_a_fit_with_the_robots_joints(tmp_path, reader, capsys):
    from hts.contracts import robot_signals
    from hts.testing.examples.objective.objective import Fake
    from hts.testing.examples.robot.robot import Tiny

    robot, objective = Tiny(), Fake()
    registry = load()
    model = registry.make_measurement_model("lstm", {"hidden": 4}, ModelContext(robot_signals(objective, robot)))
    saved = files.save(model, tmp_path / "model", {"objective": objective.name})

    class Known:
        """The registry, with the example's objective."""

        make_measurement_model = registry.make_measurement_model

        def make_objective(self, name, settings):
            assert name == objective.name
            return objective

    to = tmp_path / "exported.safetensors"
    assert export_measurement_model(None, str(saved), to, robot.spec, Known()) == to
    read = reader.MeasurementModel(to)
    assert read.joint_names == robot.spec.joint_names and read.target.name == objective.target.name
    with pytest.raises(RunError, match="exists already"):
        export_measurement_model(None, str(saved), to, robot.spec, Known())
    other = ["front", "hind"]
    of_other = files.save(
        model, tmp_path / "other", {"objective": objective.name, "robot": "bessie", "joint_names": other}
    )
    with pytest.raises(PolicyError, match=r"recordings of robot 'bessie' with the joints front, hind; 'tiny' has"):
        export_measurement_model(None, str(of_other), tmp_path / "new.safetensors", robot.spec, Known())
    export_measurement_model(None, str(of_other), tmp_path / "own.safetensors", None, Known())
    assert list(reader.MeasurementModel(tmp_path / "own.safetensors").joint_names) == other
    files.save(model, tmp_path / "nameless")
    with pytest.raises(PolicyError, match="does not say which objective"):
        export_measurement_model(None, str(tmp_path / "nameless.safetensors"), tmp_path / "new.safetensors")
    with pytest.raises(SystemExit) as stopped:
        sys.exit(
            main(["export", "--measurement-model", "nothing.safetensors", "--to", str(tmp_path / "new.safetensors")])
        )
    assert stopped.value.code == 2 and "expected a measurement model that exists" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="is written as .safetensors"):
        export_measurement_model(None, str(saved), tmp_path / "new.onnx")


def test_a_model_that_was_fitted_for_no_objective_has_no_reward_to_write_and_the_line_says_what_to_do(tmp_path):
    model = load().make_measurement_model("linear", {}, ModelContext(SIGNALS))
    saved = files.save(model, tmp_path / "model", {"objective": SIGNALS.target.name})  # as `hts fit --target` notes it
    with pytest.raises(PolicyError, match=r"fitted to --target \S+, for no objective.*hts new objective.*files\.load"):
        export_measurement_model(None, str(saved), tmp_path / "new.safetensors")
