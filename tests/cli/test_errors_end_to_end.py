"""What can go wrong for a user, from the command to the line on the screen: one line, an exit status, nothing lost.

`hts.cli.main.main` is all there is behind the command `hts`; anything but one line (a traceback) fails these tests.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from hts.cli.main import main

RUN = ["run", "--objective", "power", "--robot", "go1", "--preset", "smoke"]


@pytest.fixture
def fails(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """fails(*arguments) -> the one line on stderr of a command that ends with another status than 0."""

    def fails(*arguments: str | Path) -> str:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        line = capsys.readouterr().err
        assert status not in (0, None), line
        assert line.startswith("error: ") and line.count("\n") == 1, line
        return line

    return fails


def forget(folder: Path, *stages: str) -> None:
    """As if the run had been stopped before these stages. The report stays: it takes longest and shows nothing here."""
    for stage in (*stages, "summary"):
        (folder / f"{stage}.json").unlink()


def truncate(path: Path, share: float = 0.5) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


# ---------------------------------------------------------------------------------------------- misspelt


@pytest.mark.parametrize(
    ("arguments", "closest"),
    [
        (["--objective", "powr", "--robot", "go1"], "power"),
        (["--objective", "power", "--robot", "g01"], "go1"),
        (["--objective", "power", "--robot", "go1", "--preset", "smok"], "smoke"),
        (["--objective", "power", "--robot", "go1", "--world", "twinn"], "twin"),
        (["--objective", "power", "--robot", "go1", "--engine", "mujco"], "mujoco"),
        (["--objective", "power", "--robot", "go1", "--set", "finetune.num_env=3"], "num_envs"),
        (["--objective", "power", "--robot", "go1", "--set", "finetune.ppo.horizn=3"], "horizon"),
        (["--objective", "power", "--robot", "go1", "--set", "world.block_second=3"], "block_seconds"),
        (["--objective", "power", "--robot", "go1", "--set", "sweep.weights.powr=[1.0]"], "power"),
        (["--objective", "power", "--robot", "go1", "--set", "selection.selector.name=hierarchica"], "hierarchical"),
    ],
)
def test_a_misspelt_name_or_key_ends_in_one_line_with_the_closest(fails, tmp_path, arguments, closest):
    line = fails("run", *arguments, "--out", tmp_path / "run")
    assert f"Did you mean '{closest}'?" in line
    assert not (tmp_path / "run").exists()


def test_a_misspelt_key_in_a_file_names_the_file(fails, tmp_path):
    (tmp_path / "mine.yaml").write_text("finetune:\n  stepz: 400\n")
    line = fails(*RUN, "--config", tmp_path / "mine.yaml", "--out", tmp_path / "run")
    assert "mine.yaml" in line and "Did you mean 'steps'?" in line
    assert not (tmp_path / "run").exists()


def test_a_trial_too_short_to_judge_is_refused_before_anything_is_spent(fails, tmp_path):
    line = fails(*RUN, "--set", "simulation_test.seconds=1", "--out", tmp_path / "run")
    assert "simulation_test.seconds" in line and "3" in line
    assert not (tmp_path / "run").exists()


def test_a_bad_command_is_one_line_in_a_real_process_too(hts, tmp_path):
    done = hts("run", "--objective", "powr", "--robot", "go1", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert done.stdout == "" and done.stderr.count("\n") == 1
    assert "Did you mean 'power'?" in done.stderr


# ------------------------------------------------------------------------------------------- damaged run folders


@pytest.mark.slow
class TestDamage:
    """Each: the run stops with one line; what the line says is done; resuming then gives the undisturbed result."""

    def resumed(self, kit_run, folder: Path) -> None:
        assert main(["resume", str(folder)]) == 0
        assert kit_run.summary_of(folder) == kit_run.summary_of()

    def test_a_configuration_that_was_cut_off(self, fails, broken_kit_run):
        (broken_kit_run / "config.yaml").write_text("preset: [smoke\n")
        assert f"{broken_kit_run}/config.yaml" in fails("resume", broken_kit_run)

    def test_the_result_of_a_stage(self, fails, kit_run, broken_kit_run):
        forget(broken_kit_run)
        truncate(broken_kit_run / "iterations/00/simulate.json")
        line = fails("resume", broken_kit_run)
        assert f"{broken_kit_run}/iterations/00/simulate.json: damaged" in line and "Delete it and resume" in line
        (broken_kit_run / "iterations/00/simulate.json").unlink()
        self.resumed(kit_run, broken_kit_run)

    def test_a_recording(self, fails, kit_run, broken_kit_run):
        forget(broken_kit_run, "iterations/00/fit")
        name = json.loads((broken_kit_run / "collect.json").read_text())["recordings"][0]
        files = (broken_kit_run / "data.zarr" / name / "joint_torque").rglob("*")
        chunk = max(filter(Path.is_file, files), key=lambda file: file.stat().st_size)
        data = bytearray(chunk.read_bytes())
        data[len(data) // 2] ^= 1
        chunk.write_bytes(data)
        line = fails("resume", broken_kit_run)
        assert f"{broken_kit_run}/data.zarr/{name}/joint_torque: damaged" in line and "expected" in line
        assert f"Delete the folder {broken_kit_run}/data.zarr/{name}" in line
        assert f"delete {broken_kit_run}/collect.json too, and `hts resume {broken_kit_run}`" in line
        shutil.rmtree(broken_kit_run / "data.zarr" / name)
        (broken_kit_run / "collect.json").unlink()
        self.resumed(kit_run, broken_kit_run)

    def test_the_store(self, fails, kit_run, broken_kit_run):
        forget(broken_kit_run, "iterations/00/fit")
        truncate(broken_kit_run / "data.zarr/zarr.json")
        line = fails("resume", broken_kit_run)
        assert f"{broken_kit_run}/data.zarr/zarr.json: damaged" in line and "delete the file" in line
        (broken_kit_run / "data.zarr/zarr.json").unlink()
        self.resumed(kit_run, broken_kit_run)

    @pytest.mark.parametrize("suffix", [".safetensors", ".json"])
    def test_a_policy(self, fails, kit_run, broken_kit_run, suffix):
        forget(broken_kit_run, "iterations/00/simulate")
        truncate(broken_kit_run / f"iterations/00/candidates/00-01{suffix}")
        line = fails("resume", broken_kit_run)
        assert f"{broken_kit_run}/iterations/00/candidates/00-01{suffix}: not a" in line
        assert f"delete {broken_kit_run}/iterations/00/finetune.json and `hts resume {broken_kit_run}`" in line
        (broken_kit_run / "iterations/00/finetune.json").unlink()
        self.resumed(kit_run, broken_kit_run)

    def test_the_pretrained_policy(self, fails, kit_run, broken_kit_run):
        forget(broken_kit_run, "iterations/00/simulate")
        truncate(broken_kit_run / "policies/pretrained.safetensors")
        line = fails("resume", broken_kit_run)
        assert f"delete {broken_kit_run}/policies/pretrained.safetensors and `hts resume {broken_kit_run}`" in line
        (broken_kit_run / "policies/pretrained.safetensors").unlink()
        self.resumed(kit_run, broken_kit_run)

    def test_an_exported_policy(self, fails, kit_run, broken_kit_run):
        forget(broken_kit_run, "iterations/00/test")
        truncate(broken_kit_run / "policies/pretrained.onnx")
        line = fails("resume", broken_kit_run)
        assert "policies/pretrained.onnx: damaged, or of another policy (not a whole ONNX file" in line
        (broken_kit_run / "policies/pretrained.onnx").unlink()
        self.resumed(kit_run, broken_kit_run)

    @pytest.mark.parametrize("stage", ["finetune", "simulate", "test"])
    def test_a_measurement_model(self, fails, kit_run, broken_kit_run, stage):
        forget(broken_kit_run, f"iterations/00/{stage}", "final")
        truncate(broken_kit_run / "iterations/00/models/fake.safetensors")
        line = fails("resume", broken_kit_run)
        assert f"{broken_kit_run}/iterations/00/models/fake.safetensors: its" in line
        assert f"delete {broken_kit_run}/iterations/00/fit.json and `hts resume {broken_kit_run}` fits it anew." in line
        (broken_kit_run / "iterations/00/fit.json").unlink()
        self.resumed(kit_run, broken_kit_run)

    @pytest.fixture
    def stopped(self, broken_kit_run, monkeypatch) -> Path:
        """A run that was stopped in the middle of fine-tuning and left a checkpoint."""
        from hts.training import finetune

        forget(broken_kit_run, "iterations/00/finetune")

        def save_and_stop(*arguments, really=finetune.save_checkpoint):
            really(*arguments)
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(finetune, "CHECKPOINT_SECONDS", 0.0)
            patch.setattr(finetune, "save_checkpoint", save_and_stop)
            assert main(["resume", str(broken_kit_run)]) == 130
        return broken_kit_run

    def test_a_checkpoint(self, fails, kit_run, stopped):
        place = stopped / "iterations/00/checkpoint-0"
        truncate(place)
        line = fails("resume", stopped)
        assert f"{place}: not a whole checkpoint" in line and "Delete it and resume" in line
        place.unlink()
        self.resumed(kit_run, stopped)

    def test_a_checkpoint_of_another_robot(self, fails, kit_run, stopped):
        from hts.training.checkpoint import save_checkpoint

        place = stopped / "iterations/00/checkpoint-0"
        save_checkpoint(place, {"numbers": torch.zeros(3)}, {"robot": "hopper", "key": "k", "worlds": 4})
        line = fails("resume", stopped)
        assert (
            f"{place}: a checkpoint of robot 'hopper', this run has 'tiny'" in line and "Delete it and resume" in line
        )
        place.unlink()
        self.resumed(kit_run, stopped)


@pytest.mark.slow
def test_a_policy_of_another_robot_is_refused(fails, broken_kit_run):
    forget(broken_kit_run, "iterations/00/simulate")
    card = broken_kit_run / "iterations/00/candidates/00-01.json"
    card.write_text(card.read_text().replace('"robot": "tiny"', '"robot": "hopper"'))
    line = fails("resume", broken_kit_run)
    assert "made for robot hopper, robot 'tiny' has tiny" in line


# ------------------------------------------------------------------------------------------------------ disks


@pytest.mark.slow
def test_a_full_disk_stops_a_run_with_one_line_and_loses_nothing(kit_run, hts_kit, on_a_disk, tmp_path):
    tested = " ".join(json.loads((kit_run.folder / "iterations/00/test.json").read_text())["recordings"])
    script = f"""
cp -r "{kit_run.folder}" "$DISK/run"
for id in {tested}; do rm -r "$DISK/run/data.zarr/$id"; done
cd "$DISK/run" && \
rm -r iterations/00/finetune.json iterations/00/candidates iterations/00/test.json final.json summary.json
used=$(du -sk "$DISK" | cut -f1)
mount -o remount,size=$((used + 8))k "$DISK"
hts resume "$DISK/run" > "$OUT/first.out" 2> "$OUT/first.err"; echo $? > "$OUT/first.code"
mount -o remount,size=100m "$DISK"
hts resume "$DISK/run" > "$OUT/second.out" 2> "$OUT/second.err"; echo $? > "$OUT/second.code"
hts data validate "$DISK/run/data.zarr" > "$OUT/validate.out" 2>&1; echo $? > "$OUT/validate.code"
cp "$DISK/run/summary.json" "$OUT/summary.json"
"""
    done = on_a_disk("100m", script)
    first = (tmp_path / "first.err").read_text()
    assert (tmp_path / "first.code").read_text().strip() == "2", done.stderr + first
    assert first.count("\n") == 1 and first.startswith(f"error: {tmp_path}/disk/run"), first
    assert "full" in first and "resume" in first
    assert (tmp_path / "second.code").read_text().strip() == "0", (tmp_path / "second.err").read_text()
    assert (tmp_path / "validate.code").read_text().strip() == "0", (tmp_path / "validate.out").read_text()
    assert kit_run.summary_of(tmp_path) == kit_run.summary_of()


def test_a_read_only_disk_ends_in_one_line(on_a_disk, tmp_path):
    script = """
mkdir "$DISK/run"; echo "preset: smoke" > "$DISK/run/config.yaml"
mount -o remount,ro "$DISK"
hts run --objective power --robot go1 --preset smoke --out "$DISK/new" > "$OUT/out" 2> "$OUT/err"; echo $? > "$OUT/code"
"""
    done = on_a_disk("1m", script, modules="")
    line = (tmp_path / "err").read_text()
    assert (tmp_path / "code").read_text().strip() == "2", done.stderr + line
    assert line.count("\n") == 1
    assert line.startswith(f"error: {tmp_path}/disk/new: the file system is read-only. Choose a place")


def test_a_finished_run_on_a_read_only_disk_is_read(on_a_disk, kit_run, hts_kit, tmp_path):
    script = f"""
cp -r "{kit_run.folder}" "$DISK/run"; rm "$DISK/run/.lock"
cp -r "$DISK/run" "$DISK/other"; rm "$DISK/other/final.json"
cp -r "$DISK/run" "$DISK/begun"; rm "$DISK/begun/summary.json"
mount -o remount,ro "$DISK"
for run in run other begun; do
  hts resume "$DISK/$run" > "$OUT/$run.out" 2> "$OUT/$run.err"; echo $? > "$OUT/$run.code"
done
"""
    done = on_a_disk("100m", script)
    assert (tmp_path / "run.code").read_text().strip() == "0", done.stderr + (tmp_path / "run.err").read_text()
    assert f"report: {tmp_path}/disk/run/report.html" in (tmp_path / "run.out").read_text()
    for name in ("other", "begun"):
        line = (tmp_path / f"{name}.err").read_text()
        assert (tmp_path / f"{name}.code").read_text().strip() == "2" and line.count("\n") == 1, line
        assert line.startswith(f"error: {tmp_path}/disk/{name}/") and "the file system is read-only. " in line
        assert "--out" not in line and "--to" not in line


def test_a_full_disk_before_anything_is_written_ends_in_one_line(on_a_disk, tmp_path):
    script = """
head -c 2000000 /dev/zero > "$DISK/full" 2> /dev/null
hts run --objective power --robot go1 --preset smoke --out "$DISK/new" > "$OUT/out" 2> "$OUT/err"; echo $? > "$OUT/code"
"""
    done = on_a_disk("1m", script, modules="")
    line = (tmp_path / "err").read_text()
    assert (tmp_path / "code").read_text().strip() == "2", done.stderr + line
    assert line.count("\n") == 1 and "the disk is full" in line and f"{tmp_path}/disk/new" in line
