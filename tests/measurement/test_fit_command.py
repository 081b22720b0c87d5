"""`hts fit` and the fit of a run: what is written, refused, and told to a person."""

from __future__ import annotations

import errno
import json
from dataclasses import replace

import pytest
import torch

from hts.config import MeasurementConfig
from hts.errors import ConfigError, PluginError, RunError
from hts.measurement import files, fit_command, fit_report
from hts.measurement.data import input_tensor
from hts.measurement.lstm import LSTMSettings
from hts.recordings.recording import Series
from hts.testing.known_signals import SIGNALS, KnownHeat
from hts.testing.known_signals import known_heat as recording

SMALL = LSTMSettings(hidden=16, products=True, stream=250, batch=4)


# ------------------------------------------------------------------------------------------------ hts fit


@pytest.fixture
def store(tmp_path, monkeypatch):
    from hts import plugins
    from hts.recordings.store import RecordingStore

    cool = {"cool": plugins.Entry("cool", lambda settings: KnownHeat(), "test")}
    known = replace(plugins.load(), objectives=cool)
    monkeypatch.setattr(plugins, "load", lambda: known)
    made = RecordingStore(tmp_path / "data.zarr", create=True)
    for seed in (1, 2, 3):
        made.write(recording(seed))
    blind = recording(4)
    made.write(blind.replace(channels={n: s for n, s in blind.channels.items() if n != "heat"}, idle={}))
    return made


def test_a_block_held_out_of_a_session_that_was_fitted_to_is_said_beside_the_figure(tmp_path, monkeypatch, capsys):
    from hts import plugins
    from hts.cli.main import main
    from hts.recordings.store import RecordingStore

    cool = {"cool": plugins.Entry("cool", lambda settings: KnownHeat(), "test")}
    known = replace(plugins.load(), objectives=cool)
    monkeypatch.setattr(plugins, "load", lambda: known)

    def said(name, *sessions):
        made = RecordingStore(tmp_path / f"{name}.zarr", create=True)
        for seed, session in enumerate(sessions):
            made.write(recording(seed).replace(session=session))
        out, options = tmp_path / name, ("--set", "measurement.epochs=1")
        assert main(["fit", "--objective", "cool", "--data", str(made.path), "--out", str(out), *options]) == 0
        lines = capsys.readouterr().out.splitlines()
        return json.loads((out / "fit.json").read_text())["same_session"], lines

    count, lines = said("one", "monday", "monday", "monday")
    assert count == {"held_out": 1, "of": 1}
    figure = next(index for index, line in enumerate(lines) if line.startswith("target heat: R² "))
    assert lines[figure + 1] == (
        "target heat: what was held out is of a session that was fitted to as well, so held-out R² says little of "
        "another day and may be lower there. Whole sessions are held out by --split session."
    )
    count, lines = said("apart", "monday", "tuesday", "wednesday")
    assert count == {"held_out": 0, "of": 1} and not any("fitted to as well" in line for line in lines)


def test_how_many_are_of_a_session_that_was_fitted_to_is_said_in_words():
    def note(held_out, of):
        return fit_report.session_note({"same_session": {"held_out": held_out, "of": of}})

    assert note(2, 3).startswith("2 of 3 held-out recordings are of a session")
    assert note(1, 3).startswith("1 of 3 held-out recordings is of a session")
    assert note(3, 3).startswith("all 3 held-out recordings are of a session")
    assert note(0, 3) == fit_report.session_note({}) == ""


def test_fit_writes_a_model_and_its_checks_and_overwrites_nothing(store, tmp_path):
    few = ("measurement.epochs=3", "measurement.held_out=0.3")
    path = fit_command.fit_store("cool", store.path, tmp_path / "out", overrides=few)
    report = json.loads(path.read_text())
    assert path == tmp_path / "out" / "fit.json"
    assert len(report["training"]) == 2 and len(report["held_out"]["recordings"]) == 1
    assert report["fit"]["epochs"] == 3 and report["rank_correlation"] is None
    assert list(report["left_out"].values()) == ["has no channel 'heat'"]
    assert report["dataset"] == store.dataset([i for i in store.ids() if i not in report["left_out"]]).sha256
    assert files.load(tmp_path / "out" / "model").config == SMALL
    assert report["model"] == {"name": "lstm", **SMALL.model_dump()}
    assert report["held_out"]["linear"]["r2"] is not None
    assert "R²" in fit_report.summary_line(report)
    with pytest.raises(RunError, match="nothing is overwritten"):
        fit_command.fit_store("cool", store.path, tmp_path / "out")


@pytest.mark.parametrize(
    "text",
    ["epochs=3", "measurement.epoch=3", "objectives.warm.x=1", "measurement.epochs=0", "objectives.cool.model.=1"],
)
def test_a_wrong_setting_of_fit_is_one_line(store, tmp_path, text):
    with pytest.raises(ConfigError, match="--set") as caught:
        fit_command.fit_store("cool", store.path, tmp_path / "out", overrides=(text,))
    assert "\n" not in str(caught.value)


def test_the_model_that_is_returned_has_seen_what_was_held_out():
    recordings = [recording(seed, seconds=8.0) for seed in range(4)]
    settings = {"model": "linear"}
    checked, again = (
        fit_command.fit_and_check(KnownHeat(), recordings, MeasurementConfig(refit=refit), settings=settings)
        for refit in (False, True)
    )
    assert checked.report["refit"] is None and checked.report["fit"]["recordings"] == 3
    assert again.report["refit"]["recordings"] == 4
    assert again.report["held_out_r2"] == checked.report["held_out_r2"]  # of a fit without them
    whole = fit_command.new_model(KnownHeat(), recordings[0], settings)
    whole.fit(recordings)
    inputs = input_tensor(SIGNALS, recordings[0])[None]
    found, same, other = (one.sequence(inputs)[0].mean for one in (again.model, whole, checked.model))
    assert torch.equal(found, same) and not torch.equal(found, other)


def test_what_is_left_out_of_the_model_that_is_returned_is_what_the_report_says():
    spoilt = [recording(seed, seconds=8.0) for seed in range(4)]
    for number, place in ((1, 100), (3, 20)):  # 20: what is left before it is shorter than a second
        values = spoilt[number].values("heat").copy()
        values[place] = 1e6
        series = Series(spoilt[number].channels["heat"].channel, values)
        spoilt[number] = spoilt[number].replace(channels={**spoilt[number].channels, "heat": series})
    found = fit_command.fit_and_check(KnownHeat(), spoilt, MeasurementConfig(), settings={"model": "linear"})
    (left_out,), masked = found.report["masked"]["why"].items(), found.report["masked"]
    assert left_out == ("heat", (2, 1e6, "W")) and (masked["samples"], masked["short"]) == (2, 20)
    whole = sum(one.num_samples for one in spoilt)
    assert found.report["refit"]["samples"] == whole - masked["samples"] - masked["short"]


def test_fit_and_check_uses_the_given_configuration():
    config = MeasurementConfig(epochs=2, held_out=0.5)
    report = fit_command.fit_and_check(
        KnownHeat(), [recording(1, seconds=6.0), recording(2, seconds=6.0)], config
    ).report
    assert report["fit"]["epochs"] == 2
    assert report["held_out_r2"] == report["held_out"]["r2"]


# --------------------------------------------------------------------------------------- what a person should know


def test_the_command_prints_what_is_doubtful_after_its_summary(store, tmp_path, monkeypatch, capsys):
    from hts.cli import fit as fit_cli

    monkeypatch.setattr(fit_report, "doubts", lambda report: [f"doubt of {report['target']}"])
    fit_cli.command(store.path, tmp_path / "out", "cool", set_=["measurement.epochs=1"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("model") and [line.split()[0] for line in lines[1:4]] == ["mean", "proxy", "proxy,"]
    summary = lines.index(next(line for line in lines if line.startswith("target heat: R²")))
    assert lines[summary + 1] == "doubt of heat" and lines[-1].endswith("fit.json")


# --------------------------------------------------------------------------------------- a model that goes wrong


@pytest.fixture
def odd(store, monkeypatch):
    """odd(fit) -> the fit of a model from `odd-lab` whose `fit` is that function, into a folder."""
    from hts import plugins
    from hts.measurement.linear import Linear, LinearSettings

    def fit_with(out, fit, settings=None, name="odd"):
        class Odd(Linear):
            @property
            def settings(self):
                return super().settings if settings is None else settings

        Odd.fit = lambda self, recordings, **how: fit(self, Linear.fit, recordings, how)
        entry = plugins.Entry("odd", lambda given, context: Odd(LinearSettings(), context.signals), "odd-lab")
        known = plugins.load()
        known = replace(known, measurement_models={**known.measurement_models, "odd": entry})
        monkeypatch.setattr(plugins, "load", lambda: known)
        return fit_command.fit_store("cool", store.path, out, overrides=(f"objectives.cool.model={name}",))

    return fit_with


def with_tensor(model, really, recordings, how):
    return {**really(model, recordings, **how), "x": torch.zeros(3)}


def with_nan(model, really, recordings, how):
    return {**really(model, recordings, **how), "error": float("nan")}


def nothing(model, really, recordings, how):
    really(model, recordings, **how)


def misspelt(model, really, recordings, how):
    return model.no_such_thing


@pytest.mark.parametrize(
    ("fit", "said"),
    [
        (with_tensor, r"its report holds 'x': Tensor, which JSON cannot hold"),
        (with_nan, r"its report holds 'error': float, which JSON cannot hold"),
        (nothing, r"gives a NoneType, expected a report: a dict of JSON values"),
        (misspelt, r"failed, AttributeError: .*no_such_thing"),
    ],
)
def test_a_fit_that_goes_wrong_is_one_line_with_its_package_and_leaves_nothing(odd, tmp_path, fit, said):
    with pytest.raises(PluginError, match=rf"^Measurement model 'odd' \(from odd-lab\): fit\(\):? ?{said}") as caught:
        odd(tmp_path / "out", fit)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_settings_that_no_file_can_hold_stop_it_before_it_is_fitted(odd, tmp_path):
    with pytest.raises(PluginError, match=r"\(from odd-lab\): its `settings` holds 'width'"):
        odd(tmp_path / "out", nothing, settings={"width": torch.zeros(1)})
    assert not (tmp_path / "out").exists()


def test_a_fit_that_the_disk_stopped_takes_its_files_away(odd, tmp_path, monkeypatch):
    def full(path, content, **_):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(fit_command, "atomic_write", full)
    with pytest.raises(RunError, match="No space left"):
        odd(tmp_path / "out", nothing, name="linear")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("name", ["fit.json", "model.json", "model.safetensors"])
def test_a_fit_overwrites_no_file_of_another(odd, tmp_path, name):
    (tmp_path / name).write_text("precious")
    with pytest.raises(RunError, match=f"{name} exists: nothing is overwritten"):
        odd(tmp_path, nothing, name="linear")
    assert (tmp_path / name).read_text() == "precious"


def test_a_fit_that_ran_out_of_memory_still_says_what_to_do():
    from hts.cli.one_line import one_line
    from hts.guarded import guarded

    def full():
        raise MemoryError

    with pytest.raises(PluginError) as caught:
        guarded("Measurement model 'odd': fit()", full)
    line, _ = one_line(caught.value)
    assert line.startswith("error: Measurement model 'odd': fit() failed") and "Out of memory." in line
