"""`hts fit` on the log of a six-joint arm that hts knows by its log alone (a UR3e, recorded by others)."""

import json
import os
from pathlib import Path

import pytest

from hts.cli import fit, import_
from hts.measurement.fit_report import cautions, table
from hts.testing.packages import on_path, write_package
from hts.testing.starters import write_starter

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs")) / "ur3e"
pytestmark = [
    pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder"),
    pytest.mark.slow,
]

MAPPING = """\
time: {column: timestamp, unit: s}
rate_hz: 25
joints: {base: "0", shoulder: "1", elbow: "2", wrist_1: "3", wrist_2: "4", wrist_3: "5"}
channels:
  joint_current: {columns: "actual_current_{joint}", unit: A}
  joint_velocity: {columns: "actual_qd_{joint}", unit: rad/s}
  joint_torque: {columns: "target_moment_{joint}", unit: N*m}
  supply_current: {columns: actual_robot_current, unit: A, idle: 0.68}
"""
ROBOT = {
    '("left", "right")': '("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")',
    "(1.0, 1.0)": "(56.0, 56.0, 28.0, 12.0, 12.0, 12.0)",
    "(40.0, 40.0)": "(3.2, 3.2, 3.2, 6.3, 6.3, 6.3)",
    "((-1e4, 1e4), (-1e4, 1e4))": "((-1e4, 1e4),) * 6",
    "rate_hz=50.0": "rate_hz=25.0",
    "CHANNELS = (\n": 'CHANNELS = (\n    Channel("joint_current", "A", (len(JOINTS),), "of the motor"),\n',
}
INPUTS = ["joint_current", "joint_velocity", "joint_torque"]


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """The store of the run and that of the five moves, imported with a robot of `hts new robot --log-only`."""
    folder = tmp_path_factory.mktemp("arm")
    package = write_starter("robot", "ur3e", folder, log_only=True)
    file = package / "hts_ur3e" / "robot.py"
    text = file.read_text(encoding="utf-8")
    for old, new in ROBOT.items():
        assert old in text
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8")
    write_package(package, "hts-ur3e", {}, {"ur3e": "hts_ur3e.plugin"})
    mapping = folder / "ur3e.yaml"
    mapping.write_text(MAPPING, encoding="utf-8")
    with on_path(package):
        import_.command([LOGS / "fig9.csv"], "ur3e", mapping, folder / "run.zarr")
        import_.command(sorted(LOGS.glob("L*.csv")), "ur3e", mapping, folder / "moves.zarr")
        yield folder / "run.zarr", folder / "moves.zarr"


def fitted(stores, out, **options):
    fit.command(stores[0], out, None, "supply_current", INPUTS, **options)
    report = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    print("\n".join(table(report)))
    return report, {row["name"]: row["r2"] for row in report["compared"]}


def test_the_best_model_of_the_whole_run_predicts_the_five_moves_better_than_the_fitted_proxy(stores, tmp_path):
    report, r2 = fitted(stores, tmp_path / "out", test=stores[1], models="linear,lstm", best=True, keep_shared=True)
    assert report["model"]["name"] == "linear"  # by cross-validation inside the run
    assert report["held_out_r2"] >= 0.90
    assert report["held_out_r2"] > max(r2["proxy"], r2["proxy, smoothed"], r2["lstm"], r2["mean"])
    # The moves were cut from this very run, and that is said.
    assert any("225 of 225 held-out samples are in the recordings to fit to as well" in one for one in cautions(report))


def test_without_the_moves_in_the_run_it_still_beats_the_proxy(stores, tmp_path):
    report, r2 = fitted(stores, tmp_path / "out", test=stores[1])
    assert report["shared"] == {"held_out": 225, "of": 225, "removed": 249}
    assert 0.82 <= report["held_out_r2"] <= 0.93
    assert report["held_out_r2"] > max(r2["proxy"], r2["proxy, smoothed"]) + 0.05
    assert any("only 6.8 s are scored" in line for line in cautions(report))


def test_the_rest_of_the_run_is_predicted_from_its_first_70_percent(stores, tmp_path):
    report, r2 = fitted(stores, tmp_path / "out", split="chronological=0.7", models="lstm")
    assert report["shared"]["held_out"] == 0
    assert r2["linear"] > max(r2["proxy"], r2["proxy, smoothed"], r2["lstm"])
    assert any("the LSTM loses to linear" in line for line in cautions(report))
