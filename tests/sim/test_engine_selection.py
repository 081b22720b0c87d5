"""Which engine runs, and what a user reads where the one that was asked for cannot: one line, status 2, no folder made.

A missing package, a missing or old driver and a full memory are made at the boundary: where Python, torch or Warp say
so.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import yaml

pytest.importorskip("hts_go1", reason="the robot of these commands is not installed")
pytest.importorskip("hts_power", reason="the objective of these commands is not installed")

import hts.run
from hts.cli.device_faults import device_fault
from hts.cli.main import main
from hts.cli.one_line import one_line, resumable
from hts.config_loading import load_config
from hts.errors import ConfigError, RunError
from hts.sim import selection
from hts.sim.selection import make_engine

RUN = ("run", "--objective", "power", "--robot", "go1", "--preset", "smoke")
PRETRAIN = ("pretrain", "--robot", "go1", "--set", "num_envs=2", "--set", "steps=48")
OOM = (
    "CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 79.11 GiB of which 1.2 GiB is free."
)
WARP_OOM = "Failed to allocate 9437184 bytes on device 'cuda:0'"
OLD = (
    "The NVIDIA driver on your system is too old (found version 11040). "
    "Please update your GPU driver by downloading it."
)


@pytest.fixture
def fails(capsys):
    """fails(*arguments) -> the one line of a command that ends with status 2."""

    def fails(*arguments: object) -> str:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        shown = capsys.readouterr()
        assert status == 2, shown.err
        assert shown.err.startswith("error: ") and shown.err.count("\n") == 1, shown.err
        return shown.err

    return fails


def in_a_process(tmp_path: Path, *arguments: str, **environment: str) -> str:
    """The same of the command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "hts.cli.main", *arguments],
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
        cwd=tmp_path,
        env={**os.environ, **environment},
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


# --------------------------------------------------------------------------------------------- what is missing


def test_without_a_cuda_device_the_warp_engine_is_refused_before_anything_is_spent(tmp_path):
    line = in_a_process(
        tmp_path,
        *RUN,
        "--engine",
        "warp",
        "--out",
        str(tmp_path / "run"),
        CUDA_VISIBLE_DEVICES="",
        NVIDIA_VISIBLE_DEVICES="void",
    )
    assert "CUDA" in line and "--engine mujoco" in line
    assert not (tmp_path / "run").exists()


def test_a_cpu_build_of_torch_is_named_as_the_reason(fails, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    line = fails(*RUN, "--engine", "warp", "--out", tmp_path / "run")
    assert "this PyTorch is a CPU build" in line and "--engine mujoco" in line
    line = fails(*PRETRAIN, "--engine", "warp", "--out", tmp_path / "policy")
    assert "this PyTorch is a CPU build" in line
    assert not (tmp_path / "run").exists() and not (tmp_path / "policy").exists()


def test_without_its_package_the_warp_engine_says_what_to_install(tmp_path):
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "mujoco_warp.py").write_text("raise ModuleNotFoundError(\"No module named 'mujoco_warp'\")\n")
    path = os.pathsep.join([str(blocked), *filter(None, [os.environ.get("PYTHONPATH")])])
    line = in_a_process(
        tmp_path,
        *RUN,
        "--engine",
        "warp",
        "--set",
        "finetune.env.device=cpu",
        "--out",
        str(tmp_path / "run"),
        PYTHONPATH=path,
    )
    assert "No module named 'mujoco_warp'" in line
    assert "pip install 'hard-to-sim[gpu]'" in line and "--engine mujoco" in line
    assert not (tmp_path / "run").exists()


def test_a_driver_too_old_for_torch_is_named_with_its_version(fails, tmp_path, monkeypatch):
    def init():
        raise RuntimeError(OLD)

    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "init", init)
    line = fails(*RUN, "--engine", "warp", "--out", tmp_path / "run")
    assert "too old (found version 11040)" in line and "update the NVIDIA driver" in line
    assert not (tmp_path / "run").exists()


def test_a_driver_too_old_for_captured_graphs_is_named_with_both_versions(fails, tmp_path, monkeypatch):
    warp = pytest.importorskip("warp", reason="the extra `gpu` is not installed")
    monkeypatch.setattr(torch.version, "cuda", "12.6")
    monkeypatch.setattr(torch.cuda, "init", lambda: None)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(warp, "is_cuda_available", lambda: True)
    monkeypatch.setattr(warp, "get_cuda_driver_version", lambda: (12, 2))
    line = fails(*RUN, "--engine", "warp", "--out", tmp_path / "run")
    assert "supports CUDA 12.2" in line and "12.4 or newer" in line and "update the driver" in line


def test_too_many_worlds_for_the_memory_end_in_one_line(fails, tmp_path, monkeypatch):
    pytest.importorskip("mujoco_warp", reason="the extra `gpu` is not installed")
    from hts.sim import warp_engine

    def full(*_):
        raise RuntimeError(WARP_OOM)

    monkeypatch.setattr(warp_engine.WarpEngine, "__init__", full)
    line = fails(*PRETRAIN, "--engine", "warp", "--set", "env.device=cpu", "--out", tmp_path / "policy")
    assert "2 worlds do not fit into the memory" in line and "num_envs" in line


def test_an_update_that_needs_more_memory_than_there_is_ends_in_one_line(fails, tmp_path, monkeypatch):
    from hts.training import trainer

    def full(*_):
        raise torch.OutOfMemoryError(OOM)

    monkeypatch.setattr(trainer.PopulationTrainer, "learn", full)
    monkeypatch.setattr(trainer.PopulationTrainer, "batch", full)
    line = fails(*PRETRAIN, "--engine", "mujoco", "--out", tmp_path / "policy")
    assert "Tried to allocate 2.00 GiB" in line and "num_envs" in line and "max_candidates" in line


def test_a_run_out_of_memory_says_how_it_goes_on(tmp_path):
    (tmp_path / "config.yaml").write_text("preset: smoke\n")
    with pytest.raises(RunError, match=f"num_envs.*hts resume {tmp_path}") as caught, resumable(tmp_path):
        raise torch.OutOfMemoryError(OOM)
    line = one_line(caught.value)
    assert line is not None and "\n" not in line[0] and line[1] == 2


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (torch.OutOfMemoryError(OOM), "Out of memory"),
        (RuntimeError(WARP_OOM), "Out of memory"),
        (MemoryError(), "Out of memory"),
        (
            RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory: you tried"),
            "Out of",
        ),
        (RuntimeError("std::bad_alloc"), "Out of memory (std::bad_alloc)"),
        (ImportError("/lib/x.so: failed to map segment from shared object"), "Out of memory (/lib/x.so: failed to map"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "Out of memory ([Errno 12] Cannot allocate memory)"),
        (RuntimeError("can't start new thread"), "starts no more threads: memory, or what one user may start"),
        (RuntimeError(OLD), "driver is too old"),
        (RuntimeError("CUDA driver version is insufficient for CUDA runtime version"), "driver is too old"),
        (RuntimeError("No CUDA GPUs are available"), "No CUDA device"),
        (AssertionError("Torch not compiled with CUDA enabled"), "No CUDA device"),
        (RuntimeError("CUDA error: an illegal memory access was encountered\nCompile with ..."), "nvidia-smi"),
    ],
)
def test_what_the_libraries_say_becomes_what_to_do(error, expected):
    fault = device_fault(error)
    assert fault is not None and expected in fault and "\n" not in fault
    assert one_line(error) == (f"error: {fault}", 2)


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("shape mismatch"),
        ValueError("out of memory"),
        KeyError("cuda error"),
        ImportError("No module named 'x'"),
        OSError(errno.ENOENT, "No such file or directory", "x"),
    ],
)
def test_other_errors_keep_their_traceback(error):
    assert device_fault(error) is None and one_line(error) is None


# --------------------------------------------------------------------------------------------------- automatic


@pytest.fixture
def usable(monkeypatch):
    """usable(reason): from here on the warp engine works (None) or is missing for a reason."""

    def usable(reason: str | None) -> None:
        def require(device: str = "auto") -> None:
            if reason is not None:
                raise ConfigError(reason)

        monkeypatch.setattr(selection, "require_warp", require)
        monkeypatch.setattr(selection, "has_driver", lambda: True)

    return usable


def test_auto_is_warp_where_it_works_and_mujoco_where_it_does_not(usable):
    usable(None)
    assert [selection.select_engine(name) for name in ("auto", "warp", "mujoco")] == ["warp", "warp", "mujoco"]
    usable("no CUDA")
    assert [selection.select_engine(name) for name in ("auto", "mujoco")] == ["mujoco", "mujoco"]
    with pytest.raises(ConfigError, match="no CUDA"):
        selection.select_engine("warp")


def test_where_no_driver_is_auto_asks_no_further(monkeypatch):
    monkeypatch.setattr(selection, "has_driver", lambda: False)
    monkeypatch.setattr(selection, "require_warp", lambda device: pytest.fail("asked"))
    assert selection.select_engine("auto") == "mujoco"


def test_auto_takes_no_slow_double_of_the_gpu_engine(usable):
    usable(None)
    assert selection.select_engine("auto", device="cpu") == "mujoco"


def test_a_gpu_that_auto_cannot_use_is_told_with_the_reason(usable, monkeypatch):
    messages: list[str] = []
    usable("the package is missing")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert selection.select_engine("auto", tell=messages.append) == "mujoco"
    assert len(messages) == 1 and "the package is missing" in messages[0]
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert selection.select_engine("auto", tell=messages.append) == "mujoco"
    assert len(messages) == 1  # no GPU, nothing to tell


def test_quick_is_automatic_and_an_engine_that_is_named_is_taken():
    def engine(**given: str) -> str:
        return load_config(objectives=["power"], robot="go1", **given).engine

    assert engine() == "auto"
    assert engine(engine="mujoco") == "mujoco"
    assert (engine(preset="smoke"), engine(preset="paper")) == ("mujoco", "warp")


@pytest.mark.parametrize(("reason", "expected"), [(None, "warp"), ("no CUDA", "mujoco")])
def test_a_run_is_written_down_with_the_engine_that_runs(usable, monkeypatch, tmp_path, reason, expected):
    usable(reason)
    seen = []
    monkeypatch.setattr("hts.run.algorithm.run", lambda config, folder, registry: seen.append(config.engine) or folder)
    hts.run.start_run(load_config(objectives=["power"], robot="go1"), tmp_path / "run")
    assert yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["engine"] == expected
    assert seen == [expected]


def test_a_run_is_resumed_with_its_engine_or_not_at_all(usable, monkeypatch, tmp_path, fails):
    usable(None)
    monkeypatch.setattr("hts.run.algorithm.run", lambda config, folder, registry: folder)
    hts.run.start_run(load_config(objectives=["power"], robot="go1"), tmp_path / "run")
    usable("no CUDA here")
    assert "no CUDA here" in fails("resume", tmp_path / "run")
    (tmp_path / "run" / "summary.json").write_text("{}")  # finished: only its table is shown
    assert main(["resume", str(tmp_path / "run")]) == 0


def test_an_env_made_by_hand_may_ask_for_auto_too(usable):
    import mujoco

    usable("no CUDA")
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    engine = make_engine("auto", [model], [0], 1)
    assert type(engine).__name__ == "MujocoEngine"
    engine.close()
