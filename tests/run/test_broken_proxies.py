"""A proxy that is no number for each sample is one line that names it: before a run, in a fit, in training."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from hts.config_loading import load_config
from hts.errors import PluginError
from hts.measurement.fit_command import fit_store
from hts.measurement.proxy import proxy_along
from hts.measurement.transform import ProxyTransform
from hts.plugins import Entry, load
from hts.recordings.store import RecordingStore
from hts.run.ready import check_ready
from hts.testing.known_signals import KnownHeat, known_heat
from hts.testing.packages import kit_installed


def raises(channels):
    raise ValueError("boom")


BROKEN = {
    "a channel that is no input": (lambda c: c["joint_velocty"].sum(-1), "reads 'joint_velocty', which is none of its"),
    "no sum over joints": (
        lambda c: c[next(iter(c))] ** 2,
        r"gave shape \(.*, .\) for .*sum over joints with .sum\(-1\)",
    ),
    "one number for all": (lambda c: c[next(iter(c))].sum(), r"gave shape \(\) for"),
    "numpy": (lambda c: c[next(iter(c))].sum(-1).numpy(), "gave ndarray, expected a torch.Tensor"),
    "not finite": (lambda c: (c[next(iter(c))].sum(-1) * 0).log(), "is -inf at sample 0 of"),
    "an exception": (raises, "failed, ValueError: boom"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_proxy_is_told_before_a_run_whatever_pays_in_it(name, monkeypatch):
    from hts.testing.examples.objective.objective import Fake

    proxy, said = BROKEN[name]
    monkeypatch.setattr(Fake, "proxy", lambda self, channels: proxy(channels))
    with kit_installed(), pytest.raises(PluginError, match=said) as caught:
        check_ready(load_config(preset="smoke", objectives=["fake"], robot="tiny", world="known"), load())
    assert str(caught.value).startswith("Objective 'fake': proxy()") and "\n" not in str(caught.value)


@pytest.mark.parametrize("angle", [lambda x: x.acos(), lambda x: x.sqrt(), lambda x: (1 - x.square()).sqrt()])
def test_a_proxy_that_is_a_number_only_where_its_channel_can_be_is_none_of_these(angle, monkeypatch):
    from hts.testing.examples.objective.objective import Fake

    monkeypatch.setattr(Fake, "proxy", lambda self, channels: angle(channels[next(iter(channels))][..., 0]))
    with kit_installed():
        check_ready(load_config(preset="smoke", objectives=["fake"], robot="tiny", world="known"), load())


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_proxy_is_told_by_a_fit_before_anything_is_fitted(name, monkeypatch, tmp_path):
    proxy, said = BROKEN[name]
    monkeypatch.setattr(KnownHeat, "proxy", lambda self, channels: proxy(channels))
    known = replace(load(), objectives={"cool": Entry("cool", lambda settings: KnownHeat(), "test")})
    monkeypatch.setattr("hts.plugins.load", lambda: known)
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    for seed in (1, 2):
        store.write(known_heat(seed))
    with pytest.raises(PluginError, match=said) as caught:
        fit_store("cool", store.path, tmp_path / "out", say=pytest.fail)
    assert re.match(r"Objective '\w+': proxy\(\)", str(caught.value)) and not (tmp_path / "out").exists()


def test_a_sample_that_is_not_finite_is_named_with_its_recording(monkeypatch):
    recording = known_heat(1)
    monkeypatch.setattr(
        KnownHeat, "proxy", lambda self, c: (c["effort"][:, 0] * 0 + 1).index_fill(0, torch.tensor(7), np.nan)
    )
    with pytest.raises(
        PluginError, match=rf"proxy\(\) is nan at sample 7 of {recording.num_samples} of recording {recording.id}"
    ):
        proxy_along(KnownHeat(), recording)


def test_in_training_the_proxy_is_named_and_no_robot(monkeypatch):
    monkeypatch.setattr(KnownHeat, "proxy", lambda self, channels: channels["effort"].square())
    made = ProxyTransform(KnownHeat())
    channels = TensorDict({"effort": torch.ones(2, 3, 2), "rate": torch.ones(2, 3, 2)}, (2, 3))
    with pytest.raises(PluginError, match=r"Objective '\w+': proxy\(\) gave shape \(2, 3, 2\) for .*expected \(2, 3\)"):
        made.record(channels)
