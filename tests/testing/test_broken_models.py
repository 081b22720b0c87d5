"""Measurement models with one fault each: the kit names it, in one line."""

from __future__ import annotations

import itertools
import time

import pytest

from hts.contracts import ModelContext
from hts.errors import PluginError
from hts.plugins import load
from hts.testing.conformance import check_package
from hts.testing.known_signals import SIGNALS
from hts.testing.packages import on_path

SOURCE = """
from hts import hookimpl
{head}

HTS_API = 2


def make(settings, context):
    import torch
    from dataclasses import replace
    from hts.channels import Channel
    from hts.contracts import Prediction
    from hts.measurement.torch_model import TorchModel
    from hts.testing.examples.measurement_model.model import Fading, Settings

    class Model(Fading):
        '''Sound, but for what a test changes.'''
{body}

    signals = context.signals
    {made}


@hookimpl
def hts_measurement_models(register):
    register("odd", make)
"""
MADE = "return Model(Settings(**settings), signals)"


def faults(install, body: str = "", head: str = "", made: str = MADE) -> list[str]:
    """Lines of everything that is not kept; body: indented by 8 in front, methods of the model."""
    source = SOURCE.format(body=body, head=head, made=made)
    with on_path(install("odd-lab", {"odd_lab": source}, {"odd": "odd_lab"})):  # processes that are started see it too
        return [finding.line() for finding in check_package(load(), "odd-lab") if finding.fault is not None]


def test_a_sound_model_passes(install):
    assert faults(install) == []


def test_a_fit_that_ends_the_process_is_a_fault_and_not_the_end_of_the_check(install):
    found = faults(install, body="        def fit(self, *given, **how):\n            raise SystemExit(3)")
    assert any("measurement model 'odd': SystemExit: 3" in line for line in found)


def test_a_network_whose_layers_are_made_from_a_seed_of_their_own_passes(install):
    assert faults(install, **network(), made=OWN_SEED) == []


def test_a_network_that_adds_nan_where_an_input_is_infinite_passes(install):
    refuses = "".join(
        f"\n        def {name}(self, inputs, state{default}):"
        f"\n            prediction, state = super().{name}(inputs, state)"
        "\n            bad = (inputs - inputs).sum(-1)"
        "\n            return Prediction(prediction.mean + bad, prediction.std), state\n"
        for name, default in (("step", ""), ("sequence", "=None"))
    )
    assert faults(install, body=SATURATED + refuses) == []


SETTLES = """
        settles = True

        def settled(self, inputs):
            return {settled}
"""
MINUTE = "return Model(Settings(**{'seconds': (60.0,)} | settings), signals)"


def test_what_a_model_of_a_minute_settles_at_is_waited_for(install):
    body = SETTLES.format(settled="self._read(self.scaled_features(inputs))")
    assert faults(install, body=body, made=MINUTE) == []


def test_a_slow_machine_finds_the_same_fault(install, monkeypatch):
    """Whatever the clock says, here half an hour from one look at it to the next."""
    hours = itertools.count(0.0, 1800.0)
    monkeypatch.setattr(time, "monotonic", lambda: next(hours))
    squared = "return (target - self.target_mean) / self.target_std**2"
    found = faults(install, body=f"        def normalise_target(self, target):\n            {squared}")
    assert any("follows the target (correlation 0.98) with" in line for line in found)


def test_a_file_of_that_name_in_the_current_folder_takes_no_ones_place(install, tmp_path, monkeypatch):
    (tmp_path / "odd_lab.py").write_text("raise RuntimeError('not this one')\n")
    monkeypatch.chdir(tmp_path)
    assert faults(install) == []


AROUND = """
        def {method}(self, inputs, state=None):
            {before}
            prediction, state = super().{method}(inputs, state)
            {after}
            return prediction, state
"""


def step(before: str = "pass", after: str = "pass") -> dict[str, str]:
    return {"body": AROUND.format(method="step", before=before, after=after)}


def sequence(before: str = "pass", after: str = "pass") -> dict[str, str]:
    return {"body": AROUND.format(method="sequence", before=before, after=after)}


SATURATED = """
        def scaled_features(self, inputs):
            return super().scaled_features(inputs).tanh()
"""


FIT = """
        def fit(self, recordings, **how):
            {before}
            report = super().fit(recordings, **how)
            {after}
            return report
"""


def fit(before: str = "", after: str = "") -> dict[str, str]:
    return {"body": FIT.format(before=before or "pass", after=after or "pass")}


GAIN = """
        gain = 1.0

        def fit(self, recordings, **how):
            report = super().fit(recordings, **how)
            self.gain = 1.5
            return report

        def _read(self, averages):
            return Prediction(self.gain * super()._read(averages).mean)
"""

COUNTED = """
        asked = 0

        def step(self, inputs, state):
            self.asked += 1
            prediction, state = super().step(inputs, state)
            return Prediction(prediction.mean + 0.1 * self.asked), state
"""

NETWORK = """
        def __init__(self, config, signals):
            TorchModel.__init__(self, signals, config.products)
            self.config = config
            self.memory = torch.nn.GRU(self.num_features, 8, batch_first=True)
            self.head = torch.nn.Linear(8, 1)
            self.eval()

        def fit(self, recordings, *, seed=0, epochs=20, max_seconds=1e9, progress=None, warm_start=None):
            from hts.measurement.data import training_data
            pieces = training_data(self.signals, recordings)
            inputs = torch.stack([one.inputs for one in pieces])
            target = torch.stack([one.target for one in pieces])
            self.set_statistics(inputs.flatten(0, 1), target.flatten())
            optimiser = torch.optim.Adam(self.parameters(), 3e-2)
            for epoch in range(epochs):
                error = (self.sequence(inputs)[0].mean - {target}).square().mean()
                optimiser.zero_grad()
                error.backward()
                optimiser.step()
                if progress is not None:
                    progress(epoch + 1, epochs, float(error))
            return {{"epochs": epochs}}

        def initial_state(self, num_worlds):
            return torch.zeros(num_worlds, 8, device=self.device)

        def step(self, inputs, state):
            with torch.no_grad():
                prediction, state = self.sequence(inputs[:, None], state)
            return Prediction(prediction.mean[:, 0]), state

        def sequence(self, inputs, state=None):
            past = None if state is None else state[None].contiguous()
            output, state = self.memory(self.scaled_features(inputs), past)
            return Prediction(self.head(output)[..., 0] + 0 * inputs.sum(-1)), state[0]
"""


def network(target: str = "self.normalise_target(target)") -> dict[str, str]:
    """A GRU that is fitted by passes to what is made of the target."""
    return {"body": NETWORK.format(target=target)}


OWN_SEED = f"with torch.random.fork_rng(devices=[]):\n        torch.manual_seed(0)\n        {MADE}"
NO_LIMIT = """
        def fit(self, recordings, *, seed=0, epochs=20):
            return super().fit(recordings, seed=seed, epochs=epochs)
"""


def settings(given: str) -> dict[str, str]:
    return {"body": f"        @property\n        def settings(self):\n            return {given}"}


OTHER_UNIT = "signals = replace(signals, target=Channel(signals.target.name, 'V')); " + MADE


def test_the_fit_whose_scale_is_judged_may_take_its_time(install):
    limit = "if how['epochs'] > 1 and how['max_seconds'] < 1e9: raise ValueError('a limit of time')"
    assert faults(install, **fit(before=limit)) == []


@pytest.mark.parametrize(
    ("broken", "fault"),
    [
        ({"head": "import torch"}, "imports torch when it is loaded"),
        ({"made": "return {}"}, "is a dict, not a hts.contracts.MeasurementModel"),
        ({"made": "return Model(Settings(), signals)"}, "takes the setting 'no_such_setting_of_anything'"),
        ({"made": OTHER_UNIT}, "is made for 'heat' in W and says 'heat' in V"),
        (fit(after="self.weight += 0.01 * torch.randn(self.num_features)"), "fitting it twice gives two 'weight'"),
        (fit(after="self.target_mean.zero_()"), "target_mean is 0, of the recordings it is"),
        (
            {
                "body": "        def normalise_target(self, target):\n            return target",
            },
            "along the recordings that it was fitted to, where standard deviations are about 0 ± 1",
        ),
        (network(), "is made with numbers from a global random generator, as layers of torch.nn draw them"),
        (
            fit(before="torch.manual_seed(0)"),
            "fit draws from a global random generator",
        ),
        (
            network("(target - self.target_mean)") | {"made": OWN_SEED},
            "along the recordings that it was fitted to, where standard deviations are about 0 ± 1",
        ),
        ({"body": NO_LIMIT}, "fit() does not take what it will be given, got an unexpected keyword argument"),
        (fit(after="how['progress'](0, 1, 0.5)"), "fit tells progress(0, 1, …), expected whole numbers"),
        (
            fit(after="how['progress'](1, 1, torch.tensor(0.5))"),
            "fit tells progress an error of tensor(0.5000), expected a finite float",
        ),
        (fit(after="how['warm_start'] and how['warm_start'].no_such_thing"), "has no attribute 'no_such_thing'"),
        (settings("{}"), "its settings hold [], no 'products'"),
        (settings("Settings().model_dump(mode='json')"), "its settings hold products=True when it is made with prod"),
        (
            {"body": "        def normalise_target(self, target):\n            return target - self.target_mean"},
            "where standard deviations are about 0 ± 1 (the target is 60 ± 20 W)",
        ),
        (
            {
                "body": "        def normalise_target(self, target):\n"
                "            return (target - self.target_mean) / self.target_std**2"
            },
            "follows the target (correlation 0.98) with",
        ),
        (step(after="prediction = prediction.mean"), "step gives a Tensor as its prediction, expected"),
        (
            {"body": "        def step(self, inputs, state):\n            return super().step(inputs, state)[0]"},
            "step gives a Prediction, expected hts.contracts.Prediction and the state",
        ),
        (fit(before="len(recordings[0].channels)"), "no recordings ends in a traceback, IndexError"),
        ({"body": GAIN}, "it predicts something else after it was saved and loaded"),
        (fit(after="self.register_buffer('more', torch.ones(3))"), "it holds 'more', which the model does not have"),
        (step(after="prediction = Prediction(prediction.mean[:, None])"), "step: mean has shape (5, 1), not (5,)"),
        (step(after="prediction = Prediction(prediction.mean, -torch.ones(len(inputs)))"), "step: std is below 0"),
        (
            step(after="prediction = Prediction(prediction.mean + 0.1)"),
            "sequence is off from step after step by up to 0.1",
        ),
        (
            step(after="prediction = Prediction(prediction.mean, 3 + prediction.std)"),
            "sequence: std is off from step after step by up to 3 standard deviations",
        ),
        (
            step(after="prediction = Prediction(prediction.mean)"),
            "sequence gives a std, step after step gives none",
        ),
        (
            sequence(after="prediction = Prediction(prediction.mean)"),
            "sequence gives no std, step after step gives one",
        ),
        (
            {
                "body": "        def steps(self, inputs, state, ended):\n"
                "            prediction, state = super().steps(inputs, state, ended)\n"
                "            return Prediction(prediction.mean, prediction.std + 0.5), state"
            },
            "steps: std is off from step after step by up to 0.5 standard deviations",
        ),
        (
            sequence(before="state = None"),
            "sequence in two parts, the second from the state after the first, is off from one whole sequence by up to",
        ),
        ({"body": SETTLES.format(settled="self._read(0 * self.scaled_features(inputs))")}, "s of the same inputs"),
        ({"body": SETTLES.format(settled="inputs.sum(-1)")}, "settled gives a Tensor, expected hts.contracts"),
        (
            step(before="state = state.mean(0).expand_as(state)"),
            "the prediction of world 0 depends on the worlds beside it",
        ),
        (step(before="inputs = inputs.nan_to_num()"), "of an input that is nan"),
        ({"body": SATURATED}, "of an input that is inf"),
        (step(before="state += 0.01"), "changes its state in place"),
        (
            step(after="prediction = Prediction(prediction.mean + torch.randn(prediction.mean.shape))"),
            "step predicts something else of the same inputs and state",
        ),
        ({"body": COUNTED}, "step predicts something else of the same inputs and state"),
        (step(before="inputs = inputs / max(1.0, float(inputs.abs().max()) / 1e6)"), "looks at a value"),
        (
            {"body": "        def reset(self, state, begun):\n            return self.initial_state(len(begun))"},
            "reset of one world changes the memory of others",
        ),
        (
            {"body": "        def reset(self, state, begun):\n            return state * ~begun[:, None]"},
            "reset leaves NaN in the memory of a world that ended in it",
        ),
        (
            {
                "body": "        def tensors(self):\n"
                "            return {k: v for k, v in super().tensors().items() if k != 'bias'}"
            },
            'Missing key(s) in state_dict: "bias"',
        ),
    ],
)
def test_a_faulty_model_is_named_with_its_fault(install, broken, fault):
    found = faults(install, **broken)
    print(*found, sep="\n")
    assert len(found) <= 2, found  # a fault may break two demands, and is not repeated in the line of every check
    assert any(fault in line for line in found), found
    assert all(line.startswith(("odd-lab: measurement model 'odd': ", "odd-lab: module odd_lab: ")) for line in found)
    assert all("\n" not in line for line in found)


def test_a_step_that_gives_no_pair_is_one_line(install):
    (line,) = faults(install, body=AROUND.format(method="step", before="pass", after="return prediction"))
    assert "step gives a Prediction, expected hts.contracts.Prediction and the state" in line


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ("{}", "hold no 'ridge', though it was made with ridge=0.5"),
        ("Settings().model_dump(mode='json')", "hold ridge=0.001, though it was made with ridge=0.5"),
    ],
)
def test_settings_that_a_model_forgets_end_what_would_save_it(install, given, fault):
    install("odd-lab", {"odd_lab": SOURCE.format(**{"head": "", "made": MADE} | settings(given))}, {"odd": "odd_lab"})
    with pytest.raises(PluginError, match=rf"Measurement model 'odd' \(from odd-lab\): its `settings` {fault}"):
        load().make_measurement_model("odd", {"ridge": 0.5}, ModelContext(SIGNALS))
