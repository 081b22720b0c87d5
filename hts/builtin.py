"""What the core itself offers, through the same hooks as everybody else's plugins.

The factories import inside, so that loading the registry stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hts import hookimpl

if TYPE_CHECKING:
    from hts.contracts import LogReader, MeasurementModel, ModelContext, Selector, Settings, World, WorldContext
    from hts.hookspecs import Register

HTS_API = 2


@hookimpl
def hts_measurement_models(register: Register) -> None:
    register("lstm", make_lstm)
    register("linear", make_linear)
    register("ensemble", make_ensemble)


@hookimpl
def hts_worlds(register: Register) -> None:
    register("twin", make_twin)
    register("field", make_field)


@hookimpl
def hts_selectors(register: Register) -> None:
    register("hierarchical", make_hierarchical)
    register("pareto", make_pareto)
    register("racing", make_racing)


@hookimpl
def hts_log_readers(register: Register) -> None:
    register("csv", make_csv)
    register("parquet", make_parquet)
    register("npz", make_npz)
    register("ros", make_ros)
    register("lerobot", make_lerobot)


def make_lstm(settings: Settings, context: ModelContext) -> MeasurementModel:
    """A small recurrent network: for what depends on the past in ways nobody wrote down."""
    from hts.measurement.lstm import make

    return make(settings, context)


def make_linear(settings: Settings, context: ModelContext) -> MeasurementModel:
    """Ridge regression on inputs, their products and their past: for little data, and to compare with."""
    from hts.measurement.linear import make

    return make(settings, context)


def make_ensemble(settings: Settings, context: ModelContext) -> MeasurementModel:
    """Several models of one kind, fitted to samples of the recordings: mean and spread, and a reward that doubts."""
    from hts.measurement.ensemble import make

    return make(settings, context)


def make_twin(settings: Settings, context: WorldContext) -> World:
    """A simulated reality, in a process of its own."""
    from hts.worlds.twin.world import make_twin

    return make_twin(settings, context)


def make_field(settings: Settings, context: WorldContext) -> World:
    """A person with a robot."""
    from hts.worlds.field import make_field

    return make_field(settings, context)


def make_hierarchical(settings: Settings) -> Selector:
    """The best in simulation are tested in reality, the best of those goes on."""
    from hts.selection.hierarchical import make

    return make(settings)


def make_pareto(settings: Settings) -> Selector:
    """Several objectives: test along the simulated front, go on with the best compromise that was measured."""
    from hts.selection.pareto import make

    return make(settings)


def make_racing(settings: Settings) -> Selector:
    """Elites are tested in short rounds until it is clear who is best: the same answer for less of the robot's time."""
    from hts.selection.racing import make

    return make(settings)


def make_csv(settings: Settings) -> LogReader:
    """Comma-separated files; a mapping says which column is which channel."""
    from hts.recordings.csv_reader import make

    return make(settings)


def make_parquet(settings: Settings) -> LogReader:
    """Parquet files; a mapping says which column is which channel."""
    from hts.recordings.parquet_reader import make

    return make(settings)


def make_npz(settings: Settings) -> LogReader:
    """NPZ files of numpy; a mapping says which array is which channel."""
    from hts.recordings.npz_reader import make

    return make(settings)


def make_ros(settings: Settings) -> LogReader:
    """ROS 2 bags and MCAP files, without ROS; a mapping says which field of which topic is which channel."""
    from hts.recordings.ros_reader import make

    return make(settings)


def make_lerobot(settings: Settings) -> LogReader:
    """LeRobot datasets, layout v3; each episode is a recording."""
    from hts.recordings.lerobot_reader import make

    return make(settings)
