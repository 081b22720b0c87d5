"""A run: Algorithm 1 in `algorithm`, its stages' work in `learning`, `reality` and `testing_elites`,
the rest beside."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hts.config import RunConfig
    from hts.plugins import Registry


def start_run(config: RunConfig, out: Path, *, dry_run: bool = False, registry: Registry | None = None) -> Path:
    """Run into the new folder `out`; returns it. dry_run: only say what it would cost;
    registry: left out, it is loaded.

    Raises RunError if the folder holds something already (nothing is ever overwritten) or cannot be made, also of a
    dry run. Whatever can be wrong with
    names, settings and folder shows before anything heavy is imported; then everything that the run will need is built
    once (`hts.run.ready`), before anything is written.
    """
    from hts.config_loading import check_names
    from hts.places import check_new_folder, check_place
    from hts.plugins import load
    from hts.whole_paths import with_whole_paths

    registry = registry or load()
    if not dry_run:
        check_new_folder(Path(out))
    refuse_oracle(config)
    check_names(config, registry)
    check_place(Path(out), "--out DIR")
    config = with_engine(config)
    from hts.evaluation.held import not_held_in_training, not_tried
    from hts.parts import robot_of
    from hts.run.ready import check_ready

    robot = robot_of(config, registry)
    for note in filter(None, (not_held_in_training(config, robot), not_tried(config, robot))):
        print(note, file=sys.stderr)
    if dry_run:
        from hts.run.cost import check_memory, estimate, print_estimate, print_ready
        from hts.run.speed import control_steps_per_second

        check_ready(config, registry)
        check_memory(estimate(config, registry))  # before a part of it is trained to measure how fast it goes
        print_estimate(estimate(config, registry, control_steps_per_second(config, registry)))
        print_ready(config)
        return Path(out)
    check_ready(
        config, registry, config.engine if config.engine == "mujoco" else None
    )  # kernels take minutes to compile
    make_folder(with_whole_paths(config, registry), Path(out))
    return resume_run(out, registry)


def resume_run(folder: Path, registry: Registry | None = None) -> Path:
    """Go on where a run stopped; a finished run says that it is, and prints its table again.

    The engine is asked for only where something is left to simulate: the last trials and the final can be made on the
    computer beside the robot, whatever the run was trained on.
    """
    from hts.config_loading import read_config

    config = read_config(Path(folder) / "config.yaml")
    refuse_oracle(config)
    if simulates_yet(config, Path(folder)):
        config = with_engine(config)

    from hts.plugins import load
    from hts.run import algorithm

    return algorithm.run(config, Path(folder), registry or load())


def simulates_yet(config: RunConfig, folder: Path) -> bool:
    """Whether a run still trains, judges or asks the gate, as far as its folder tells: it does until whom the last
    iteration tries is known."""
    from hts.run.stage_files import gate_is_due, read_stage
    from hts.run.stages import ENDED_EARLY

    tested = (folder / f"iterations/{index:02d}" for index in range(config.iterations))
    if any(gate_is_due(config, one) for one in tested if (one / "test.json").exists()):  # its result was deleted
        return True
    last = folder / f"iterations/{config.iterations - 1:02d}"
    over = (last / "test.json", folder / ENDED_EARLY, folder / "confirm.json", folder / "summary.json")
    if any(path.exists() for path in over):
        return False
    chosen = last / ("gate.json" if config.gate.enabled else "simulate.json")
    if not chosen.exists():
        return True
    if not (config.gate.enabled and config.gate.nearer) or (last / "nearer.json").exists():
        return False
    gate = read_stage(chosen)
    barred = gate["kept_out"] or any(not row["passed"] for row in gate["policies"].values())
    return bool(gate["strict"]) and (not gate["elites"] or (config.gate.nearer_for == "first" and bool(barred)))


def refuse_oracle(config: RunConfig) -> None:
    """Raise ConfigError: a run learns from what was measured, and cannot look into a reality."""
    from hts.errors import ConfigError

    if config.reward_source == "oracle":
        raise ConfigError(
            "--reward (reward_source): `oracle` looks into the reality, which no run can. Expected model or proxy; "
            "what was possible says `hts oracle`."
        )


def with_engine(config: RunConfig) -> RunConfig:
    """The configuration with the engine that `auto` stands for here, so that everything written names what really ran.

    Raises ConfigError if the engine cannot work on this machine: before minutes of a robot are spent on data.
    """
    from hts.sim.selection import select_engine

    engine = select_engine(config.engine, config.finetune.env.device, tell=lambda line: print(line, file=sys.stderr))
    return config.model_copy(update={"engine": engine})


def make_folder(config: RunConfig, out: Path) -> None:
    """The folder with its config.yaml, which is all that `resume_run` needs."""
    from hts.atomic import atomic_write
    from hts.config_loading import dump_config
    from hts.places import check_new_folder

    check_new_folder(out)  # again: somebody else may have begun there since
    out.mkdir(parents=True, exist_ok=True)  # before the file, so that an error names the folder that was asked for
    atomic_write(out / "config.yaml", dump_config(config))
