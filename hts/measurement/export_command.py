"""`hts export --measurement-model`: which model, with which objective's reward, in whose order of joints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hts.errors import ConfigError, PolicyError, RunError, unknown_name
from hts.measurement import files
from hts.places import check_new_file, resume_command

if TYPE_CHECKING:
    from hts.contracts import RobotSpec
    from hts.plugins import Registry


def export_measurement_model(
    folder: Path | None, model: str, to: Path, robot: RobotSpec | None = None, registry: Registry | None = None
) -> Path:
    """Write a fitted model to the file `to`, as `export.export_model` does; returns it.

    folder: a run, then model names an objective of it, and the last iteration's model is taken; None: model is a
    .safetensors of `hts fit`; robot: whose order of joints the recordings have, of a run its own.
    Raises RunError, ConfigError and PolicyError with what is missing.
    """
    from hts import plugins
    from hts.measurement.export import export_model

    registry = registry or plugins.load()
    if to.suffix != ".safetensors":
        raise ConfigError(f"--to {to}: a measurement model is written as .safetensors. Name the file so.")
    check_new_file(to)
    if folder is None:
        path = Path(model)
        if path.suffix != ".safetensors" or not path.is_file():
            raise PolicyError(
                f"{model}: expected a measurement model that exists, a model.safetensors of `hts fit`; or a run folder "
                "and the name of its objective: hts export DIR --measurement-model NAME."
            )
        card = files.read_card(path)
        notes = card.get("notes") or {}
        name, settings = notes.get("objective"), {}
        if not isinstance(name, str):
            raise PolicyError(
                f"{path.with_suffix('.json')}: does not say which objective it was fitted for. Fit it with `hts fit`, "
                "or export it from its run: hts export DIR --measurement-model NAME."
            )
        target = card.get("signals", {}).get("target", {}).get("name")  # files of format 1 name none
        if name == target and name not in registry.objectives:
            raise PolicyError(
                f"{path}: fitted to --target {name}, for no objective, and the file is to hold an objective's reward. "
                "Write one whose target is that channel (`hts new objective NAME`), and fit again with --objective; "
                "to predict in Python, hts.measurement.files.load opens the model as it is."
            )
    else:
        from hts.config_loading import read_config
        from hts.parts import robot_of

        config = read_config(folder / "config.yaml")
        if model not in config.objectives:
            raise ConfigError("--measurement-model: " + unknown_name("objective of this run", model, config.objectives))
        name, settings = model, config.objectives[model]
        found = sorted((folder / "iterations").glob(f"*/models/{model}.safetensors"))
        if not found:
            raise RunError(
                f"{folder}: has fitted no model of '{model}' yet. `{resume_command(folder)}` goes on with it."
            )
        path = found[-1]
        if robot is None:
            robot = robot_of(config, registry).spec
        notes = files.read_card(path).get("notes") or {}
    objective = registry.make_objective(name, settings)
    names = notes.get("joint_names") if robot is None else list(robot.joint_names)
    if robot is not None and notes.get("joint_names") not in (None, names):
        raise PolicyError(
            f"{path}: fitted to recordings of robot '{notes.get('robot')}' with the joints "
            f"{', '.join(map(str, notes['joint_names']))}; '{robot.name}' has {', '.join(robot.joint_names)}. Leave "
            "--robot out, or name the robot that was recorded."
        )
    return export_model(files.load(path, registry=registry), objective, to, joint_names=names, notes=notes)
