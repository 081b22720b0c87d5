"""Measurement models on disk: what is written comes back, of every kind and earlier format; nothing else is taken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch

from hts.contracts import ModelContext
from hts.errors import PolicyError
from hts.measurement import files
from hts.plugins import load
from hts.testing.known_signals import SIGNALS, known_heat

DATA = Path(__file__).resolve().parents[1] / "data"
KINDS = {
    "lstm": {"hidden": 8, "products": True},
    "linear": {"lags": 3},
    "ensemble": {"members": 2, "member": {"name": "lstm", "hidden": 4}, "beta": 0.5},
}


def fitted(name: str):
    model = load().make_measurement_model(name, KINDS[name], ModelContext(SIGNALS))
    model.fit([known_heat(seed, seconds=8.0) for seed in range(2)], epochs=1)
    return model


@pytest.mark.parametrize("name", KINDS)
def test_a_saved_model_comes_back_equal(name, tmp_path):
    model = fitted(name)
    path = files.save(model, tmp_path / "model", {"dataset": "d1"})
    loaded = files.load(path)
    assert (loaded.name, loaded.settings, loaded.signals) == (name, model.settings, SIGNALS)
    assert loaded.pessimism == model.pessimism
    data = torch.randn(4, 6, generator=torch.Generator().manual_seed(0))
    for before, after in zip(*(m.step(data, m.initial_state(4))[0] for m in (model, loaded)), strict=True):
        assert (before is None and after is None) or torch.equal(before, after)
    assert torch.equal(loaded.denormalise(data), model.denormalise(data))
    assert files.read_card(path)["notes"] == {"dataset": "d1"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.json", "model.safetensors"]


def test_a_file_of_format_1_still_opens_and_predicts_what_it_predicted():
    model = files.load(DATA / "measurement-model-v1")
    assert (model.name, model.settings["hidden"], model.settings["layers"]) == ("lstm", 4, 2)
    assert (model.signals.names, model.signals.sizes, model.signals.target.name) == (("effort", "rate"), (3, 3), "heat")
    assert not model.signals.units_known  # that format held none
    inputs = torch.arange(1, 13, dtype=torch.float32).reshape(2, 6) / 10
    state, found = model.initial_state(2), []
    for step in range(3):
        prediction, state = model.step(inputs + step, state)
        found.append(prediction.mean)
    # seen when the file was written
    expected = [[-0.2713185, -0.2687349], [-0.3420718, -0.3175174], [-0.3436266, -0.3134088]]
    torch.testing.assert_close(torch.stack(found), torch.tensor(expected), rtol=1e-5, atol=1e-6)


def test_a_model_of_format_1_is_written_in_format_2_and_comes_back(tmp_path):
    model = files.load(DATA / "measurement-model-v1")
    path = files.save(model, tmp_path / "model")
    assert files.read_card(path)["version"] == 2
    assert files.load(path).signals == model.signals


def test_damaged_files_are_refused_in_one_line(tmp_path):
    path = files.save(fitted("lstm"), tmp_path / "model")
    whole, card = path.read_bytes(), json.loads(path.with_suffix(".json").read_text())

    def refused(numbers: bytes, text: str, said: str) -> None:
        path.write_bytes(numbers)
        path.with_suffix(".json").write_text(text)
        with pytest.raises(PolicyError, match=said) as caught:
            files.load(path)
        assert "\n" not in str(caught.value)

    refused(whole[:-100], json.dumps(card), "truncated")
    refused(whole, json.dumps(card)[:50], "not JSON")
    refused(whole, json.dumps(card | {"format": "other"}), "'other'")
    refused(whole, json.dumps(card | {"version": 99}), "version 99")
    refused(whole, json.dumps({k: v for k, v in card.items() if k != "settings"}), "'settings' is missing")
    refused(whole, json.dumps(card | {"model": "lstn"}), "Did you mean 'lstm'")
    refused(whole, json.dumps(card | {"settings": {"hiden": 8}}), "Did you mean 'hidden'")
    refused(whole, json.dumps(card | {"settings": {**card["settings"], "hidden": 9}}), "has shape .* the model has")
    refused(whole, json.dumps(card | {"settings": {**card["settings"], "layers": 2}}), "is missing")
    refused(whole, json.dumps(card | {"signals": {**card["signals"], "target": {"name": "x"}}}), "KeyError: 'unit'")
    with pytest.raises(PolicyError, match="cannot be read"):
        files.load(tmp_path / "nowhere")


def test_a_model_of_another_kind_is_not_mistaken_for_this_one(tmp_path):
    lstm, linear = (files.save(fitted(name), tmp_path / name) for name in ("lstm", "linear"))
    card = json.loads(lstm.with_suffix(".json").read_text())
    other = json.loads(linear.with_suffix(".json").read_text())
    shutil.copy(linear, lstm)
    lstm.with_suffix(".json").write_text(json.dumps(card | {"sha256": other["sha256"]}))
    with pytest.raises(PolicyError, match="it holds 'bias', which the model does not have"):
        files.load(lstm)


def test_a_folder_is_told_from_a_model_with_the_file_that_a_fit_writes(tmp_path):
    with pytest.raises(PolicyError) as caught:
        files.load(tmp_path)
    wanted = f"{tmp_path / 'model.safetensors'}, which is not there."
    assert str(caught.value) == f"{tmp_path}: is a folder, expected a measurement model. `hts fit` writes {wanted}"
    files.save(fitted("linear"), tmp_path / "model")
    with pytest.raises(PolicyError, match="model.safetensors, which is there: give that path"):
        files.load(tmp_path)
