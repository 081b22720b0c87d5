"""`hts oracle`: what was possible on a twin, for somebody who sees inside. Two kinds, and neither is a method.

on_reality      candidates train on the reality itself, paid by the truth: a lower estimate of what is possible there
in_simulation   `hts run` whose reward alone sees inside: what a measurement model that never errs would be worth
"""

from __future__ import annotations

import sys
from pathlib import Path

from hts.config import RunConfig
from hts.config_loading import check_names, read_config
from hts.errors import ConfigError
from hts.oracle import in_simulation, on_reality
from hts.places import check_new_folder, check_place
from hts.plugins import Registry, load
from hts.run import make_folder
from hts.run.algorithm import run
from hts.whole_paths import with_whole_paths
from hts.worlds.oracle import IN_SIMULATION, NOTE


def start_oracle(config: RunConfig, folder: Path, *, dry_run: bool = False, registry: Registry | None = None) -> Path:
    """An oracle into the new folder; returns it. Raises what `hts.run.start_run` raises, and ConfigError for a world
    that is not simulated here: only a twin can be looked into."""
    registry = registry or load()
    if not dry_run:
        check_new_folder(Path(folder))
    check_place(Path(folder), "--out DIR")
    kind = in_simulation if sees_only_the_reward(config) else on_reality
    config = kind.prepared(config, registry)
    check_oracle(config, registry)
    kind.check(config, registry)
    if dry_run:
        from hts.run.cost import check_memory, estimate, print_estimate

        check_memory(estimate(config, registry))
        print_estimate(estimate(config, registry, kind.control_steps_per_second(config, registry)))
        print(note_of(config))
        return folder
    make_folder(with_whole_paths(config, registry), folder)
    return resume_oracle(folder, registry)


def resume_oracle(folder: Path, registry: Registry | None = None) -> Path:
    """Go on with an oracle where it stopped; the stage that it stopped in begins anew."""
    config = read_config(Path(folder) / "config.yaml")
    print(note_of(config), file=sys.stderr)
    job = in_simulation.SimulatedOracleJob if sees_only_the_reward(config) else on_reality.OracleJob
    return run(config, Path(folder), registry or load(), job)


def sees_only_the_reward(config: RunConfig) -> bool:
    """Whether candidates train in simulation."""
    return config.oracle_trains_in == "simulation"


def note_of(config: RunConfig) -> str:
    """What must be said beside every result."""
    return IN_SIMULATION if sees_only_the_reward(config) else NOTE


def check_oracle(config: RunConfig, registry: Registry) -> None:
    """What holds for both kinds, before anything is spent: each mistake is one line."""
    if config.reward_source != "oracle":
        raise ConfigError(
            f"reward_source: expected oracle in `hts oracle`, found {config.reward_source}. Leave it out, or take "
            "`hts run` or `hts baseline`."
        )
    if config.world.name != "twin":
        raise ConfigError(
            f"World '{config.world.name}' cannot be looked into: an oracle needs a twin. Leave --world out, and name a "
            "reality by --set world.reality=NAME."
        )
    check_names(config, registry)
