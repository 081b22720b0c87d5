"""The table beside the chosen model, and who is kept where the best is wanted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hts import plugins
from hts.channels import Channel
from hts.cli import fit as fit_cli
from hts.cli.fit_progress import FitProgress
from hts.errors import ConfigError, RecordingError
from hts.measurement import comparison, fit_command
from hts.measurement.baseline import WINDOWS_SECONDS, fit_best, stand_ins
from hts.measurement.fit_command import FitChecks
from hts.measurement.fit_report import cautions, doubts, table
from hts.measurement.split import named_part
from hts.measurement.split_rule import SplitRule
from hts.measurement.wanted import Wanted
from hts.recordings.recording import Series
from hts.recordings.store import RecordingStore
from hts.testing.known_signals import HEAT, SIGNALS, KnownHeat, known_heat

QUICK = ("measurement.epochs=1",)
INPUTS = ("effort", "rate")


def store_of(path, *recordings):
    store = RecordingStore(path, create=True)
    for recording in recordings:
        store.write(recording.replace(id=""))
    return store.path


@pytest.fixture(autouse=True)
def cool(monkeypatch):
    known = replace(plugins.load(), objectives={"cool": plugins.Entry("cool", lambda settings: KnownHeat(), "test")})
    monkeypatch.setattr(plugins, "load", lambda: known)


@pytest.fixture
def run(tmp_path):
    return store_of(tmp_path / "run.zarr", known_heat(1))


def fitted(tmp_path, store, name="cool", **how):
    """fit.json as it was written."""
    return json.loads(fit_command.fit_store(name, store, tmp_path / "out", overrides=QUICK, **how).read_text())


def rows_of(report):
    return {row["name"]: row for row in report["compared"]}


@pytest.mark.parametrize("level", [0.1, 23.4, 123.456, 1e4 / 3])
def test_a_stand_in_that_was_constant_explains_nothing(level):
    """A temperature that did not change while it was recorded: rounding is no slope."""
    walk = known_heat(1, seconds=60.0)
    heat = np.random.default_rng(0).standard_normal(3000).cumsum() * 0.01
    walk = walk.replace(channels={**walk.channels, "heat": Series(HEAT, heat)})
    constant = {"Σ|temperature|": lambda channels: np.full(len(channels["heat"]), level)}
    for windows in ((0.0,), WINDOWS_SECONDS):
        _, fit = fit_best(constant, "heat", [walk], windows)
        assert fit.scale == 0.0 and fit.predict(np.full(9, level + 0.5)) == pytest.approx([heat[50:].mean()] * 9)


def test_mean_proxies_and_linear_are_scored_on_the_samples_of_the_chosen_model(tmp_path, run):
    report = fitted(tmp_path, run, checks=FitChecks(split=SplitRule.parsed("chronological=0.7")))
    rows = rows_of(report)
    assert list(rows) == ["mean", "proxy", "proxy, smoothed", *list(rows)[3:]] and set(rows) >= {"lstm", "linear"}
    assert rows["mean"]["r2"] <= 0.0
    assert rows["proxy, smoothed"]["r2"] > 0.999  # KnownHeat is a smoothed line of its own stand-in
    assert rows["proxy"]["r2"] < 0.9 and rows["linear"]["r2"] > 0.9
    assert rows["lstm"]["kind"] == "kept" and rows["lstm"]["r2"] == report["held_out"]["r2"]
    assert report["held_out"]["linear"]["r2"] == pytest.approx(rows["linear"]["r2"])
    assert "2 × its own + 5, 40 ms late, mean over 100 ms" in rows["proxy, smoothed"]["detail"]
    assert "first 70 %" in report["split"]


def test_the_best_inside_the_training_is_kept_and_the_losing_lstm_is_told(tmp_path, run):
    report = fitted(tmp_path, run, checks=FitChecks(split=SplitRule.parsed("chronological=0.7"), best=True))
    assert report["model"]["name"] == "linear" and report["objective"] == "cool"
    assert report["best_of"]["linear"] > report["best_of"]["lstm"]
    kept = rows_of(report)["linear"]
    assert kept["kind"] == "kept" and kept["cross_validated"] == report["best_of"]["linear"]
    said = cautions(report)
    assert any("the LSTM loses to linear, R²" in line for line in said)
    assert any("linear is no better than a formula: it loses to proxy, smoothed" in line for line in said)
    assert "inside" in table(report)[0] and any(line.startswith("linear *") for line in table(report))


def test_the_best_is_chosen_without_a_look_at_what_is_held_out(tmp_path, run):
    # On the held-out side the target is noise: whoever looked there would choose another.
    first = fitted(tmp_path, run, checks=FitChecks(split=SplitRule.parsed("chronological=0.5"), best=True))
    r = known_heat(1)
    heat = r.values("heat").copy()
    heat[500:] = np.random.default_rng(0).normal(5.0, 1.0, 500)
    spoiled = store_of(tmp_path / "spoiled.zarr", r.replace(channels={**r.channels, "heat": Series(HEAT, heat)}))
    checks = FitChecks(split=SplitRule.parsed("chronological=0.5"), best=True)
    second = json.loads(
        fit_command.fit_store("cool", spoiled, tmp_path / "other", overrides=QUICK, checks=checks).read_text()
    )
    assert second["best_of"] == pytest.approx(first["best_of"]) and second["model"] == first["model"]
    assert second["held_out_r2"] < 0.1 < first["held_out_r2"]


def test_little_held_out_is_warned_of(tmp_path, run):
    short = fitted(tmp_path, run, checks=FitChecks(split=SplitRule.parsed("chronological=0.7")))
    assert short["held_out"]["seconds"] == pytest.approx(5.0)
    assert any("only 5.0 s are scored, less than 30 s" in line for line in cautions(short))
    short["held_out"]["seconds"] = 30.0
    assert not any("are scored" in line for line in cautions(short))


def test_a_test_store_is_held_out_and_what_it_shares_leaves_the_training(tmp_path, run):
    move = store_of(tmp_path / "move.zarr", named_part(known_heat(1), 300, 500))
    report = fitted(tmp_path, run, checks=FitChecks(test=move))
    assert report["shared"] == {"held_out": 200, "of": 200, "removed": 250}
    assert [name.partition("[")[2] for name in report["training"]] == ["0:275]", "525:1000]"]
    assert any("200 of 200 held-out samples are in the recordings to fit to as well" in one for one in cautions(report))
    kept = json.loads(
        fit_command.fit_store(
            "cool", run, tmp_path / "kept", overrides=QUICK, checks=FitChecks(test=move, keep_shared=True)
        ).read_text()
    )
    assert kept["shared"]["removed"] == 0 and any("is no held-out figure" in line for line in cautions(kept))
    with pytest.raises(RecordingError, match="the same logs are on both sides"):
        fit_command.fit_store("cool", run, tmp_path / "self", overrides=QUICK, checks=FitChecks(test=run))


def test_recordings_of_a_test_store_that_lack_a_channel_are_listed_and_counted(tmp_path, run):
    blind = [known_heat(seed) for seed in (4, 5)]
    blind = [b.replace(channels={n: s for n, s in b.channels.items() if n != "heat"}, idle={}) for b in blind]
    tests = store_of(tmp_path / "tests.zarr", known_heat(3), *blind)
    report = fitted(tmp_path, run, checks=FitChecks(test=tests))
    assert len(report["held_out"]["recordings"]) == 1
    assert set(report["left_out"]) == set(RecordingStore(tests).ids()) - set(report["held_out"]["recordings"])
    told = "target heat: 2 recordings left out, listed in fit.json under `left_out` "
    assert cautions(report)[0] == told + "(2: of the test store, has no channel 'heat')."


def test_a_test_store_of_another_robot_is_refused(tmp_path, run):
    other = store_of(tmp_path / "other.zarr", known_heat(2, robot="another"))
    with pytest.raises(RecordingError, match="differ in robot: fake in 1 .*another in 1"):
        fitted(tmp_path, run, checks=FitChecks(test=other))


def test_one_robots_recordings_may_be_chosen_from_a_store_of_several(tmp_path):
    both = store_of(tmp_path / "both.zarr", known_heat(1), known_heat(2), known_heat(3, robot="another"))
    with pytest.raises(RecordingError, match="differ in robot"):
        fitted(tmp_path, both)
    report = fitted(tmp_path, both, wanted=Wanted(robot="fake"))
    assert list(report["left_out"].values()) == ["is of robot 'another'"]


def test_outliers_are_counted_in_the_report(tmp_path):
    r = known_heat(1)
    heat = r.values("heat").copy()
    heat[400] = 1e7
    bad = r.replace(channels={**r.channels, "heat": Series(HEAT, heat)})
    report = fitted(tmp_path, store_of(tmp_path / "bad.zarr", bad, known_heat(2)))
    assert report["masked"]["samples"] == 1
    assert cautions(report)[0].startswith(
        "target heat: 1 sample that no machine makes left out: 'heat' 1 (such as 1e+07 W)"
    )


# ------------------------------------------------------------------------------------- a target without objective


def test_a_target_can_be_fitted_without_an_objective(tmp_path, run):
    checks = FitChecks(split=SplitRule.parsed("chronological=0.7"))
    report = fitted(tmp_path, run, None, checks=checks, wanted=Wanted("heat", INPUTS))
    assert report["model"]["name"] == "linear" and report["target"] == "heat" and report["held_out_r2"] > 0.9
    assert "Σ" in rows_of(report)["proxy, smoothed"]["detail"]
    assert not any("negative scale" in line for line in cautions(report))


def test_a_formula_that_fits_with_a_negative_scale_is_told_with_its_likely_causes(tmp_path, capsys):
    r = known_heat(1)
    heat = 50.0 - r.values("heat")
    store = store_of(tmp_path / "mirrored.zarr", r.replace(channels={**r.channels, "heat": Series(HEAT, heat)}))
    fit_cli.command(store, tmp_path / "plain", None, "heat", list(INPUTS), split="chronological=0.7")
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "negative scale" in line)
    detail = rows_of(json.loads((tmp_path / "plain" / "fit.json").read_text()))["proxy, smoothed"]["detail"]
    assert line.startswith(
        f"target heat: the analytic stand-in fits with a negative scale, {detail}: more of it goes with "
    )
    assert "Σ" in line and "sign: -1" in line
    own = fitted(tmp_path, store, checks=FitChecks(split=SplitRule.parsed("chronological=0.7")))
    assert sum("negative scale" in line for line in [*doubts(own), *cautions(own)]) == 1  # not said twice


@pytest.mark.parametrize("r2", [0.05, -0.3, None])
def test_the_sign_of_a_stand_in_that_explains_nothing_is_chance(r2):
    line = {"scale": -0.5, "r2": r2}
    assert doubts({"objective": "cool", "target": "heat", "held_out": {"r2": 0.9, "proxy": {"smoothed": line}}}) == []


@pytest.mark.parametrize(
    ("name", "wanted", "said"),
    [
        (None, Wanted(), "--objective NAME, or --target CHANNEL with --input CHANNEL"),
        (None, Wanted("heat"), "--input CHANNEL for each channel"),
        ("cool", Wanted("heat", INPUTS), "leave them out"),
        (None, Wanted("heap", INPUTS), "No channel named 'heap'. Did you mean 'heat'"),
        (None, Wanted("heat", ("efort",)), "has no channel 'efort'"),
        (None, Wanted("effort", ("rate",)), r"Target 'effort' has shape \(3,\), 3 numbers a sample"),
        (None, Wanted("heat", ("effort", "heat")), r"Target 'heat' is among the inputs \(effort, heat\)"),
    ],
)
def test_what_cannot_be_fitted_is_one_line(tmp_path, run, name, wanted, said):
    with pytest.raises((ConfigError, RecordingError), match=said) as caught:
        fit_command.fit_store(name, run, tmp_path / "out", wanted=wanted)
    assert "\n" not in str(caught.value)


def test_a_target_that_was_recorded_motor_by_motor_is_one_line(tmp_path, run):
    r = known_heat(1)
    both = Series(Channel("heat", "W", (2,)), np.stack([r.values("heat")] * 2, 1))
    store = store_of(tmp_path / "motors.zarr", r.replace(channels={**r.channels, "heat": both}))
    with pytest.raises(RecordingError, match=r"'heat' has shape \(2,\), 2 numbers.*objective 'cool' predicts one"):
        fit_command.fit_store("cool", store, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_wrong_model_or_two_ways_to_split_are_told_before_anything_is_fitted(tmp_path, run):
    with pytest.raises(ConfigError, match="Did you mean 'lstm'"):
        fitted(tmp_path, run, checks=FitChecks(models=("lstn",)))
    with pytest.raises(ConfigError, match="give one of them"):
        fitted(tmp_path, run, checks=FitChecks(test=run, split=SplitRule.parsed("policy")))
    assert not (tmp_path / "out").exists()


def test_the_generic_stand_in_is_the_one_that_fits_the_training_best():
    class Bare(KnownHeat):
        def proxy(self, channels):
            return None

    recordings = []
    for seed in (1, 2):
        r = known_heat(seed)
        work = np.abs(r.values("effort") * r.values("rate")).sum(1)
        recordings.append(r.replace(channels={**r.channels, "heat": Series(HEAT, 3.0 * work + 1.0)}))
    formulas = stand_ins(Bare(), SIGNALS)
    assert {"Σ|effort|", "Σ rate²", "Σ|effort·rate|", "Σ max(effort·rate, 0)"} <= set(formulas)
    name, line = fit_best(formulas, "heat", recordings)
    assert name == "Σ|effort·rate|" and (line.scale, line.offset) == pytest.approx((3.0, 1.0), rel=1e-4)
    assert list(stand_ins(KnownHeat(), SIGNALS)) == ["its own"]


def test_folds_of_the_training_are_policies_recordings_or_stretches():
    def sizes(*policies):
        made = [known_heat(i, policy, seconds=6.0) for i, policy in enumerate(policies)]
        return [sorted(one.policy_hash for one in fold) for fold in comparison.training_folds(made)]

    assert sizes(*"aabbc") == [["a", "a"], ["b", "b"], ["c"]]
    assert sizes(*"aaaa") == [["a", "a"], ["a"], ["a"]]
    assert sizes("a") == [["a", "a"]] * 3  # two stretches of it each
    parts = [[one.num_samples for one in fold] for fold in comparison.training_folds([known_heat(0, "a", seconds=6.0)])]
    assert parts == [[50, 50]] * 3  # a second each, and no sample of the 300 is lost


# -------------------------------------------------------------------------------------------------------- on screen


def test_the_command_takes_a_split_and_prints_the_table(tmp_path, run, capsys):
    fit_cli.command(run, tmp_path / "out", None, "heat", list(INPUTS), split="chronological=0.7", models="lstm")
    out = capsys.readouterr().out
    assert "linear *" in out and "lstm" in out and "s scored" in out and "only 5.0 s are scored" in out


def test_progress_is_told_in_a_file_now_and_then_and_of_a_quick_fit_not_at_all(capsys, monkeypatch):
    from hts.cli import fit_progress

    with FitProgress() as shown:
        shown.say("fitting lstm")
        shown(1, 20, 0.5)
    assert capsys.readouterr().err == ""
    now = 0.0
    monkeypatch.setattr(fit_progress.time, "monotonic", lambda: now)
    with FitProgress() as shown:
        for now in range(0, 40, 2):
            shown(now, 40, 0.25)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and lines[0] == "fitting, epoch 10 of 40: 1 − R² 0.250 (10 s)"
