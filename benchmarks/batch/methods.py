"""Methods by name: a command of `hts` and the options that make it what it is.

Ablations are `ours` without one thing. A file adds more (`--methods FILE`): YAML, name -> command, preset, set.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hts import plugins
from hts.cli.commands import COMMANDS
from hts.config import RunConfig
from hts.config_loading import dump_config, load_config
from hts.engines import check_engine
from hts.errors import ConfigError, unknown_name
from hts.yaml_text import load_mapping_file

ORACLE = "oracle"
"""The command that looks into the twin: no method, so no rival of one in any table."""
COMMANDS_OF_RUNS = ("run", "baseline", ORACLE)
REALITY = "world.reality"
NAMES_OF_REALITIES = "hts.worlds.twin.reality"  # knows where the file of a name lies
DEFAULT_REALITY = "default"
SUFFIX = ".json"  # of a reality's file


@dataclass(frozen=True)
class Method:
    """command: of `hts`; settings: `--set` of it, KEY=VALUE each; presets: asked preset -> the one it takes ("": any).

    elsewhere: settings where the asked preset is none of `presets`. own: objective -> settings besides, for methods
    that change what belongs to an objective; with another objective such a method is refused, not run unchanged.
    own_elsewhere: the same where the asked preset is none of `presets`, and objectives that are not named need none.
    """

    command: str = "run"
    settings: tuple[str, ...] = ()
    presets: Mapping[str, str] = field(default_factory=dict)
    elsewhere: tuple[str, ...] = ()
    own: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    own_elsewhere: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


# What `quick` and `paper` do so that the gate lets candidates pass, taken back.
NO_STOPS = (
    "finetune.env.reward_weights={joint_range: 0.0, termination: -50.0}",
    "finetune.env.soft_joint_range=0.9",
    "finetune.env.randomisation.added_mass=[-1.0, 2.0]",
    "finetune.env.randomisation.delay_share=null",
    "gate.strict=null",
    "gate.nearer=[]",
)

METHODS: dict[str, Method] = {
    "ours": Method(),  # the method as shipped
    "ours-proxy": Method(settings=("reward_source=proxy",)),  # ours with the analytic stand-in as reward
    "baseline": Method(command="baseline"),  # `hts baseline`: the stand-in with its own sweep and budget
    # With `paper` the paper's recipe as we read it; in smaller presets its inputs, data and criterion in their budgets.
    "paper-exact": Method(
        presets={"paper": "paper-exact"},
        elsewhere=(
            "collection.exploring=0",
            "collection.repeats=8",  # as many recordings as ours in `quick`
            "finetune.hold=false",
            "finetune.also_at=[]",
            "finetune.average=0",
            "iterations=2",
            "finetune.steps=142000",  # 9 and 18 candidates: as many steps in all
            "sweep.trust_region.enabled=false",
            "sweep.kl_bounds=[0.2, 0.5, 1.0]",
            'sweep.anchors=["best", "pretrained"]',
            "selection.selector={name: hierarchical, each_bound: false, at_random: 0}",
            "selection.speeds=[0.8]",
            "selection.min_valid=null",
            "simulation_test.hold_speed=false",
            "simulation_test.measured_pull=false",
            "simulation_test.min_valid=0",
            "finetune.measured_pull=false",
            *NO_STOPS,
        ),
        own_elsewhere={
            "power": (
                "objectives.power.model={name: battery_current, products: false}",
                "objectives.power.criterion=net",
                "sweep.weights.power=[0.5, 1.0, 5.0]",
            ),
            "noise": (  # the paper is about power; this is its recipe, with the objective's own λ
                "objectives.noise.model={name: footfall_level, products: false}",
                "objectives.noise.criterion=mean",
            ),
        },
    ),
    "oracle": Method(command=ORACLE),  # saw inside the reality; no method: what was possible
    # Ours with the reality's own instruments for a model; no method: what a better model could add.
    "oracle-reward": Method(command=ORACLE, settings=("oracle_trains_in=simulation",)),
    # Ablations: ours without one thing.
    "lstm": Method(own={"power": ("objectives.power.model=battery_current",)}),  # the paper's kind of model
    "no-products": Method(  # a network on the plain channels, as in the paper
        own={
            "power": ("objectives.power.model={name: battery_current, products: false}",),
            "noise": ("objectives.noise.model={name: footfall_level, products: false}",),
        },
    ),
    "linear": Method(  # a ridge on products and lags
        own={"power": ("objectives.power.model=linear",), "noise": ("objectives.noise.model=linear",)},
    ),
    "late-reward": Method(  # paid as the gauge shows it
        own={"power": ("objectives.power.model={name: drive_train, instant: false}",)},
    ),
    "no-doubt": Method(  # no standard deviation in the reward
        own={"power": ("objectives.power.model={name: drive_train, beta: 0}",)},
    ),
    "no-hold": Method(settings=("finetune.hold=false",)),  # speed not held in training
    "no-hold-below": Method(settings=("finetune.hold_below=false",)),  # speed held on average alone
    "fixed-bounds": Method(settings=("sweep.trust_region.enabled=false",)),  # the same bounds in each iteration
    "no-exploring": Method(  # first data by the mean action alone
        settings=("collection.exploring=0", "collection.repeats=8"),  # as many recordings as ours
    ),
    "no-held-speed": Method(settings=("evaluation.hold_speed=false",)),  # commands as asked, speed not held
    "last-moment": Method(settings=("finetune.also_at=[]",)),  # candidates judged as their training ended, alone
    "no-stops": Method(settings=NO_STOPS),  # training as if no gate were behind it, and none on twins
    "no-average": Method(settings=("finetune.average=0",)),  # parameters as they ended, not averaged
    "prices-anew": Method(settings=("finetune.hold_from_anchor=false",)),  # prices begin at nothing each time
    "no-margin": Method(settings=("selection.min_valid=null",)),  # trials ask for no more than the final
    "no-pull": Method(  # judged and trained without the pull that trials show
        settings=("simulation_test.measured_pull=false", "finetune.measured_pull=false"),
    ),
    "no-second-trial": Method(settings=("selection.confirm=0",)),  # the best of one trial goes to the final
    "no-second-try": Method(settings=("selection.trims_again=0",)),  # walks each speed once, whatever command was found
    "one-speed": Method(settings=("selection.speeds=[0.8]",)),  # elites tried at 0.8 m/s alone
    "racing": Method(settings=("selection.selector.name=racing",)),  # elites in rounds
}


@dataclass(frozen=True)
class Job:
    """One run to be made; `key` says which. arguments: of `hts`, without the folder."""

    method: str
    method_hash: str
    reality: str
    reality_hash: str
    seed: int
    preset: str
    commit: str
    arguments: tuple[str, ...]

    @property
    def key(self) -> str:
        """The same for the same method, options, reality, seed, preset and commit, and for nothing else."""
        return digest([self.method, self.method_hash, self.reality_hash, self.seed, self.preset, self.commit])[:16]

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"{self.method}-{self.reality}-{self.preset}-{self.seed}-{self.key}"


def digest(value: Any) -> str:
    """SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def read_methods(path: Path | None) -> dict[str, Method]:
    """`METHODS` and those of a file. Raises ConfigError, naming the file and the entry."""
    found = dict(METHODS)
    for name, entry in (load_mapping_file(path) if path else {}).items():
        expected = "Expected a mapping with any of command, preset, set (a list of KEY=VALUE)"
        if not isinstance(entry, Mapping) or set(entry) - {"command", "preset", "set"}:
            raise ConfigError(f"{path}: method '{name}' is {entry!r}. {expected}.")
        settings = entry.get("set", [])
        if not isinstance(settings, list) or not all(isinstance(one, str) and "=" in one for one in settings):
            raise ConfigError(f"{path}: method '{name}': set is {settings!r}. {expected}.")
        preset = entry.get("preset")
        found[name] = Method(entry.get("command", "run"), tuple(settings), {"": preset} if preset else {})
    return found


def realities_of(text: str) -> list[str]:
    """References from `--realities`: names, `dev` (dev-00 to dev-15), files, or a folder's *.json; commas between."""
    found: list[str] = []
    for part in filter(None, (one.strip() for one in text.split(","))):
        path = Path(part)
        if part == "dev":
            found += [f"dev-{index:02d}" for index in range(16)]
        elif path.is_dir():
            found += [str(one.resolve()) for one in sorted(path.glob(f"*{SUFFIX}"))]
        elif path.suffix == SUFFIX:
            if not path.is_file():
                raise ConfigError(
                    f"--realities {part}: there is no such file. Give a name, a file or a folder of files."
                )
            found.append(str(path.resolve()))
        else:
            found.append(part)
    if not found:
        raise ConfigError(f"--realities {text}: names none. Give names or files with commas between, or `dev`.")
    return list(dict.fromkeys(found))


def seeds_of(text: str) -> list[int]:
    """`0-4`, `7` or `0,2,5-6`."""
    found: list[int] = []
    for part in text.split(","):
        low, _, high = part.partition("-")
        if not low.isdigit() or (high and not high.isdigit()) or int(high or low) < int(low):
            raise ConfigError(f"--seeds {text}: '{part}' is no seed and no range of seeds. Expected for instance 0-4.")
        found += range(int(low), int(high or low) + 1)
    return list(dict.fromkeys(found))


def jobs_of(
    methods: Mapping[str, Method],
    realities: Sequence[str],
    seeds: Sequence[int],
    *,
    objectives: Sequence[str],
    robot: str,
    preset: str,
    commit: str,
    settings: Sequence[str] = (),
    engine: str | None = None,
) -> list[Job]:
    """Every run of the batch: realities outermost and methods innermost, so that what is compared is made together.

    settings: `--set` of every method. Every method's options are resolved here, so a wrong one shows before anything
    is spent. Raises ConfigError.
    """
    common = [text for name in objectives for text in ("--objective", name)]
    common += ["--robot", robot, "--world", "twin"]
    made: dict[str, tuple[tuple[str, ...], str]] = {}
    for name, method in methods.items():
        taken = method.presets.get(preset, method.presets.get("", preset))
        own = () if preset in method.presets or "" in method.presets else method.elsewhere
        sets = [*method.settings, *own, *_of_objectives(name, method, objectives, bool(own)), *settings]
        config = _resolved(name, method, taken, sets, objectives, robot, engine)
        resolved = dump_config(config.model_copy(update={"seed": 0}))
        physics = ("--engine", engine) if engine and method.command != ORACLE else ()  # it has its own, on CPUs
        options = (*common, *physics, "--preset", taken, *(text for one in sets for text in ("--set", one)))
        made[name] = ((method.command, *options), digest([method.command, resolved]))
    return [
        Job(
            method=name,
            method_hash=hashed,
            reality=Path(reality).stem,
            reality_hash=reality_hash(reality),
            seed=seed,
            preset=preset,
            commit=commit,
            arguments=(*arguments, *_reality_option(reality), "--seed", str(seed)),
        )
        for reality in realities
        for seed in seeds
        for name, (arguments, hashed) in made.items()
    ]


def _of_objectives(name: str, method: Method, objectives: Sequence[str], elsewhere: bool) -> list[str]:
    """Settings of a method that belong to the objectives of the batch."""
    missing = [one for one in objectives if method.own and one not in method.own]
    if missing:
        raise ConfigError(
            f"Method '{name}' changes what belongs to {', '.join(method.own)}; with objective '{missing[0]}' it would "
            "be nothing of its own. Leave it out, or say it in --methods-file."
        )
    found = [text for one in objectives for text in method.own.get(one, ())]
    return found + [text for one in objectives if elsewhere for text in method.own_elsewhere.get(one, ())]


def reality_hash(reference: str) -> str:
    """SHA-256 of a reality's file, by path or by name; of its name for the default twin, which has no file.

    Raises ConfigError for a name that this version does not know, where it knows of realities at all; where it does
    not, the name stands for the file, and the run will say what is wrong.
    """
    path = Path(reference)
    if not path.is_file() and reference != DEFAULT_REALITY and find_spec(NAMES_OF_REALITIES):
        path = import_module(NAMES_OF_REALITIES).locate(reference)
    content = path.read_bytes() if path.is_file() else f"name:{reference}".encode()
    return hashlib.sha256(content).hexdigest()


def _reality_option(reference: str) -> tuple[str, ...]:
    return () if reference == DEFAULT_REALITY else ("--set", f"{REALITY}={reference}")


def _resolved(
    name: str,
    method: Method,
    preset: str,
    settings: Sequence[str],
    objectives: Sequence[str],
    robot: str,
    engine: str | None,
) -> RunConfig:
    """The configuration of a method, without reality and seed."""
    if method.command not in COMMANDS_OF_RUNS:
        raise ConfigError(f"Method '{name}': " + unknown_name("command of runs", method.command, COMMANDS_OF_RUNS))
    if method.command not in COMMANDS:
        raise ConfigError(
            f"Method '{name}' needs `hts {method.command}`, which this version does not have. Leave it out."
        )
    oracle = method.command == ORACLE
    try:
        config = load_config(
            preset=preset,
            objectives=objectives,
            robot=robot,
            world="twin",
            engine=None if oracle else engine,
            baseline=method.command == "baseline",
            oracle=oracle,
            overrides=list(settings),
        )
        check_engine(config.engine)
        registry = plugins.load()
        for kind, named in (("robots", config.robot.name), *(("objectives", one) for one in config.objectives)):
            registry.entry(kind, named)
    except ConfigError as error:
        raise ConfigError(f"Method '{name}': {error}") from error
    return config
