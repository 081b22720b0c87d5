"""Logs of a visit that are a little shorter or longer than their rows: `hts evaluate` says so, as a run does."""

from __future__ import annotations

import shutil

import pytest
from field_folder import bundle, fill_in, write_log

from hts.cli.main import main
from hts.config_loading import dump_config, load_config
from hts.policies.export import to_onnx
from hts.policies.files import load_policy

BLOCK = 6.0


@pytest.fixture
def evaluate(tmp_path, robot, capsys):
    """evaluate() -> the lines on standard error of an evaluation that a run in the world `field` asks for."""
    settings = ["evaluation.hold_speed=false", f"world.block_seconds={BLOCK}", "evaluation.speeds=[0.8]"]
    config = load_config(preset="quick", objectives=["power"], robot="go1", world="field", overrides=settings)
    (tmp_path / "config.yaml").write_text(dump_config(config))
    (tmp_path / "policies").mkdir()
    to_onnx(load_policy(robot.pretrained_policy()), tmp_path / "policies" / "pretrained.onnx")
    shutil.copyfile(tmp_path / "policies" / "pretrained.onnx", tmp_path / "policies" / "best.onnx")

    def lines() -> list[str]:
        main(["evaluate", str(tmp_path), "--speed", "0.8"])
        return capsys.readouterr().err.splitlines()

    return lines


def test_evaluate_says_which_logs_end_early_and_which_go_on(evaluate, tmp_path, robot):
    itself, waiting = evaluate()
    assert "compares it with itself" in itself and "Waiting for 4 of 4 logs" in waiting
    fill_in(tmp_path / "evaluation")
    for number, seconds in enumerate((BLOCK, 5.5, 6.56, BLOCK)):
        write_log(bundle(tmp_path / "evaluation") / "logs" / f"{number:02d}.csv", robot, seconds)
    _, early, late, *_, refused = evaluate()
    assert early == (
        "note: 1 of 4 recordings end before their schedules do, most of all 01.csv: 5.50 s of 6 s. "
        "What is missing counts for nothing."
    )
    assert late.startswith("note: 1 of 4 recordings go on after their schedules, longest 02.csv: 6.56 s for 6 s. ")
    assert "are valid" in refused  # it is said of what is refused later too
