"""Settings: what a factory is given, and what it says of wrong ones."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from pydantic import ValidationError

from hts.contracts import MODEL
from hts.errors import HtsError, PluginError
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure
from hts.testing.checks.made_up import kind_of, rest_of

NOBODY_HAS = "no_such_setting_of_anything"


class Watched(dict):
    """A dict that remembers who tried to change it."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.changes: list[str] = []


def _watch(name: str) -> None:
    def changing(self: Watched, *given: Any, **named: Any) -> Any:
        self.changes.append(f"{name.strip('_')}({', '.join(map(repr, given[:1]))})")
        return getattr(dict, name)(self, *given, **named)

    setattr(Watched, name, changing)


for _name in ("__setitem__", "__delitem__", "pop", "popitem", "setdefault", "update", "clear", "__ior__"):
    _watch(_name)


def can_be_made(entry: Entry, registry: Registry) -> None:
    """Its factory makes it without settings."""
    made = entry.factory({}, *rest_of(kind_of(entry, registry), entry, registry))
    ensure(made is not None, "its factory gives None: is `return` missing?")


def settings_are_left_alone(entry: Entry, registry: Registry) -> None:
    """The settings that its factory is given are only read: the run's own configuration hangs on them."""
    rest = rest_of(kind_of(entry, registry), entry, registry)
    for given, refused in ((Watched(), ()), (Watched({NOBODY_HAS: 1}), (Exception,))):
        with suppress(*refused):  # `wrong_settings_are_told` is about what it says
            entry.factory(given, *rest)
        ensure(not given.changes, f"changes its settings in place: {', '.join(given.changes)}")


def wrong_settings_are_told(entry: Entry, registry: Registry) -> None:
    """A setting that does not exist or has an impossible value is refused in one line that names it (pydantic does)."""
    refusal = _refusal(entry, registry, {NOBODY_HAS: 1}, NOBODY_HAS)
    ensure(refusal is not None, f"takes the setting '{NOBODY_HAS}', so a misspelt one goes unseen")
    known = re.search(r"Known: ([^.]*)\.", refusal or "")
    for key in known.group(1).split(", ") if known else ():
        if key == MODEL:  # the core's own, which it takes from what an objective is given
            continue
        _refusal(entry, registry, {key: object()}, key)


def _refusal(entry: Entry, registry: Registry, settings: dict[str, Any], key: str) -> str | None:
    """What a user would read; None if the settings are taken. Raises PluginError for a text that helps nobody."""
    kind = kind_of(entry, registry)
    make, rest = getattr(registry, f"make_{kind.removesuffix('s')}"), rest_of(kind, entry, registry)
    taken = False
    try:
        entry.factory(dict(settings), *rest)
        taken = True
    except (HtsError, ValidationError):
        pass  # what comes of it for a user is looked at below
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise PluginError(f"a wrong setting '{key}' ends in a traceback, {what}") from error
    try:
        make(entry.name, settings, *rest)
    except HtsError as error:
        if taken and isinstance(error, PluginError):  # of what was made, not of the settings
            return None
        text = str(error)
        ensure("\n" not in text and key in text, f"says of the setting '{key}': {text}")
        return text
    return None
