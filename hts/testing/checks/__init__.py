"""What `hts check` asks of each kind of thing. A check raises if its demand is not met; its docstring is the demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hts.plugins import Entry, Registry
from hts.testing.checks import (
    instruments,
    measurement_models,
    model_fits,
    names,
    objectives,
    rest,
    rewards,
    robots,
    selectors,
    settings,
    worlds,
)

Check = Callable[[Entry, Registry], None]

MADE: tuple[Check, ...] = (
    names.name_can_be_typed,
    settings.can_be_made,
    settings.settings_are_left_alone,
    settings.wrong_settings_are_told,
)
"""Of everything that a factory makes from settings."""

CHECKS: Mapping[str, tuple[Check, ...]] = {
    "objectives": (
        *MADE,
        *objectives.CHECKS,
        *rewards.CHECKS,
        objectives.reward_and_score_agree,
        objectives.reward_remembers_no_data,
    ),
    "measurement_models": (*MADE, *measurement_models.CHECKS),
    "robots": (*MADE, *robots.CHECKS),
    "worlds": (*MADE, *worlds.CHECKS),
    "instruments": (*MADE, *instruments.CHECKS),
    "selectors": (*MADE, *selectors.CHECKS),
    "log_readers": (*MADE, *rest.LOG_READER_CHECKS),
    "commands": (names.name_can_be_typed, *rest.COMMAND_CHECKS),
}
"""Kind (as in `hts.plugins.KINDS`) -> checks, in the order in which they make sense to a reader."""

NEEDED: tuple[Check, ...] = (
    settings.can_be_made,
    objectives.has_its_parts,
    objectives.channels_are_known,
    objectives.instrument_measures_the_target,
    robots.spec_is_consistent,
    robots.channels_are_standard,
    worlds.costs_nothing_yet,
    rewards.gives_one_number_per_world,
    instruments.reads_its_channels,
    model_fits.can_be_fitted,
)
"""Where one of these is not kept, the checks after it are not tried: they would only say the same in other words."""
