"""Every error a user can meet, as a tree.

    HtsError                 something a user can put right; the CLI prints its one line and exits with `exit_code`
    ├── ConfigError          a name, key or value in the command line or a config file
    ├── PluginError          a plugin that could not be loaded, or that broke its contract
    ├── RecordingError       a recording, log or store that cannot be used
    ├── PolicyError          a policy or checkpoint file that cannot be used
    ├── SimulationError      the engine, the environment or a training run went wrong (a NaN, a full buffer)
    ├── WorldError           the world where policies run "for real" could not do what was asked
    │   └── UnfitWorldError  it cannot serve this robot or objective at all: only a run in another world can
    ├── EvaluationError      recordings from which no honest number can be made (too few valid segments)
    ├── RunError             the run folder: exists already, is half-written, cannot be written
    └── WaitingForRobot      no failure: the run waits for a person and a robot

Messages say what was found, where, what was expected and what to do next, in one line.
"""

from __future__ import annotations

from collections.abc import Iterable

from hts.near import nearest


class HtsError(Exception):
    """Base of all errors that a user can put right."""

    exit_code = 2


class ConfigError(HtsError):
    """A wrong name, key or value in the command line or a config file."""


class PluginError(HtsError):
    """A plugin that could not be loaded or that broke its contract."""


class RecordingError(HtsError):
    """A recording, log or store that cannot be used."""


class PolicyError(HtsError):
    """A policy or checkpoint file that cannot be used."""


class SimulationError(HtsError):
    """The engine, the environment or a training run went wrong."""


class WorldError(HtsError):
    """The world could not do what was asked of it."""


class UnfitWorldError(WorldError):
    """This world cannot serve the run's robot or objectives: going on with the run does not help,
    another world does."""


class EvaluationError(HtsError):
    """Recordings from which no honest number can be made."""


class WaitingForRobot(HtsError):
    """Not a failure: the run waits for a person and a robot; `hts resume` goes on."""

    exit_code = 75  # EX_TEMPFAIL of sysexits.h: try again later


class RunError(HtsError):
    """The run folder exists already, is half-written, or cannot be written."""


BY_NAME: dict[str, type[HtsError]] = {
    kind.__name__: kind
    for kind in (
        HtsError,
        ConfigError,
        PluginError,
        RecordingError,
        PolicyError,
        SimulationError,
        WorldError,
        UnfitWorldError,
        EvaluationError,
        WaitingForRobot,
        RunError,
    )
}
"""For an error that another process raised and could only name."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """One line for a wrong name: the right one that is near it, if any (`hts.near`), then all of them."""
    names = sorted(known)
    close = nearest(name, names)
    hint = f" Did you mean '{close}'?" if close is not None else ""
    return f"No {kind} named '{name}'.{hint} Known: {', '.join(names) or 'none'}."
