"""Options that several commands share, so that they mean and read the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hts.cli.values import Command

if TYPE_CHECKING:
    from hts.config import RunConfig
    from hts.overrides import Override
    from hts.plugins import Registry

Objectives = Annotated[
    list[str] | None,
    typer.Option("--objective", metavar="NAME", help="What to improve; repeat for several. `hts plugins` lists them."),
]
RobotName = Annotated[
    str | None, typer.Option("--robot", metavar="NAME", help="The machine. `hts plugins` lists them.")
]
Preset = Annotated[str | None, typer.Option(help="smoke, quick (default), paper or paper-exact.")]
WorldName = Annotated[
    str | None,
    typer.Option(
        "--world",
        metavar="NAME",
        help='Where policies run "for real": twin, field, or a plugin\'s. `hts plugins` lists them.',
    ),
]
ConfigFile = Annotated[Path | None, typer.Option("--config", help="YAML file laid over the preset.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One value, key dotted; repeat for several.")
]
Engine = Annotated[str | None, typer.Option(help="Training physics: mujoco (CPU), warp (GPU), or auto.")]
Executor = Annotated[str | None, typer.Option(help="Where candidates train: local.")]
Seed = Annotated[int | None, typer.Option(help="Of everything random in the run.")]
Reward = Annotated[
    str | None,
    typer.Option(
        metavar="SOURCE", help="model (default), or proxy: the objective's formula inside the same method, to compare."
    ),
]
Out = Annotated[Path | None, typer.Option(help="Run folder; default runs/OBJECTIVE-ROBOT-PRESET-SEED.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what the run will cost, and stop.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Target = Annotated[str | None, typer.Option(metavar="CHANNEL", help="What to predict, where no objective is named.")]
Inputs = Annotated[
    list[str] | None, typer.Option("--input", metavar="CHANNEL", help="What to predict it from. May be repeated.")
]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")]
RunFolderOrNone = Annotated[
    Path | None, typer.Argument(metavar="DIR", help="A run folder; none for a policy file that belongs to no run.")
]
POLICIES = "best, pretrained, a candidate's id"
"""How policies of a run are called, for the help of --policy."""

NAMES = {"seed": "--seed", "reward_source": "--reward", "start": "--start"}
"""Key of a configuration -> the option above, or of a single command, that gives it: what a message names."""


class Group(typer.Typer):
    """A command that has commands of its own."""

    def command(self, name: str | None = None, **how: Any) -> Any:
        return super().command(name, **{"cls": Command, **how})


def group(text: str) -> Group:
    """A command that has commands of its own; text: of its help."""
    return Group(help=text, no_args_is_help=True, add_completion=False, rich_markup_mode=None)


def configured(
    objectives: Sequence[str] | None,
    robot: str | None,
    preset: str | None,
    world: str | None,
    config: Path | None,
    overrides: Sequence[str | Override] | None,
    **more: Any,
) -> tuple[Registry, RunConfig]:
    """What is installed, and the configuration that these options make of it; more: as of `load_config`."""
    from hts.config_loading import load_config
    from hts.plugins import load

    given = {"preset": preset, "robot": robot, "world": world, "file": config, "option_names": NAMES, **more}
    registry = load()
    return registry, load_config(objectives=objectives or (), overrides=overrides or (), registry=registry, **given)
