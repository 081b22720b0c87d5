"""Measurement models with one fault each: the kit names it, in one line."""

from __future__ import annotations

import pytest

from hts.plugins import load
from hts.testing.conformance import check_package
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


def test_a_file_of_that_name_in_the_current_folder_takes_no_ones_place(install, tmp_path, monkeypatch):
    (tmp_path / "odd_lab.py").write_text("raise RuntimeError('not this one')\n")
    monkeypatch.chdir(tmp_path)
    assert faults(install) == []


STEP = """
        def step(self, inputs, state):
            {before}
            prediction, state = super().step(inputs, state)
            {after}
            return prediction, state
"""


def step(before: str = "", after: str = "") -> dict[str, str]:
    return {"body": STEP.format(before=before or "pass", after=after or "pass")}


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

OTHER_UNIT = "signals = replace(signals, target=Channel(signals.target.name, 'V')); " + MADE


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
            step(before="state = state.mean(0).expand_as(state)"),
            "the prediction of world 0 depends on the worlds beside it",
        ),
        (step(before="inputs = inputs.nan_to_num()"), "of an input that is nan"),
        (step(before="state += 0.01"), "changes its state in place"),
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
