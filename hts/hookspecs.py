"""The hooks a plugin package may implement. This page is the manual.

A package offers hooks by an entry point in the group ``hts``:

    [project.entry-points.hts]
    mine = "my_package.plugin"

The module behind it is imported when any `hts` command needs the registry, so it must not import torch.
It states the version of these hooks it was written for, ``HTS_API = 2``, and implements any of them
with ``from hts import hookimpl``. Each hook gets ``register``; call it once for every thing offered.
Two plugins may not use one name: that stops the run and names both packages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pluggy

API_VERSION = 2

CHANGES: dict[int, str] = {
    1: "an objective's measurement_model() returns hts.config.Named(name='lstm', …) with the settings beside the name "
    "instead of a MeasurementModelConfig (inputs and target are the objective's own), and there is a new hook, "
    "hts_measurement_models",
}
"""Version of the hooks -> what a plugin that was written for it has to change for the next one."""

Register = Callable[[str, Callable[..., Any]], None]
"""What each hook is given, for those who annotate theirs."""

hookspec = pluggy.HookspecMarker("hts")
hookimpl = pluggy.HookimplMarker("hts")


@hookspec
def hts_objectives(register):
    """Offer objectives: a measured quantity to improve, and the model that predicts it.

    Called once, after plugins load and before the config is read.
    Call ``register(name, factory)``; ``factory(settings)`` returns a ``hts.contracts.Objective``. With
    ``register(name, factory, presets={"paper-exact": {...}})`` it has settings of its own in a preset; a user's win.
    """


@hookspec
def hts_measurement_models(register):
    """Offer measurement models: what predicts a real channel from sim channels, fitted to recordings.

    Call ``register(name, factory)``; ``factory(settings, context)`` returns a fresh, unfitted
    ``hts.contracts.MeasurementModel``; context is a ``hts.contracts.ModelContext``: what the model will read and
    predict. An objective names its default; ``objectives.NAME.model`` in the configuration chooses another.
    """


@hookspec
def hts_robots(register):
    """Offer robots: a machine's model, numbers, channels and first policy.

    Call ``register(name, factory)``; ``factory(settings)`` returns a ``hts.contracts.Robot``.
    """


@hookspec
def hts_worlds(register):
    """Offer worlds: places where policies run "for real".

    Call ``register(name, factory)``; ``factory(settings, context)`` returns a ``hts.contracts.World``;
    context is a ``hts.contracts.WorldContext``.
    """


@hookspec
def hts_instruments(register):
    """Offer instruments: simulated sensors that a twin carries. Learning code never sees them.

    Call ``register(name, factory)``; ``factory(settings, robot)`` returns a ``hts.contracts.Instrument``.
    """


@hookspec
def hts_selectors(register):
    """Offer selectors: which candidates are tested, and which tested one is the next anchor.

    Call ``register(name, factory)``; ``factory(settings)`` returns a ``hts.contracts.Selector``.
    """


@hookspec
def hts_log_readers(register):
    """Offer log readers: somebody's log format, turned into recordings.

    Call ``register(name, factory)``; ``factory(settings)`` returns a ``hts.contracts.LogReader``.
    """


@hookspec
def hts_commands(register):
    """Offer commands of the `hts` command line.

    Call ``register(name, factory)``; ``factory()`` returns a function with typer annotations.
    """
