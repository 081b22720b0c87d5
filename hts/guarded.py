"""A call into a plugin's code, after which whatever goes wrong there is one line that says whose it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from hts.errors import HtsError, PluginError
from hts.explain import explain

Made = TypeVar("Made")


def guarded(what: str, work: Callable[[], Made]) -> Made:
    """The result of a plugin's code. Its own HtsErrors pass; PluginError, beginning with `what`,
    for anything unforeseen."""
    try:
        return work()
    except HtsError:
        raise
    except (Exception, SystemExit) as error:  # a plugin's sys.exit would end hts without a word
        from pydantic import ValidationError

        if isinstance(error, ValidationError):
            raise PluginError(f"{what}: {error.title}: {explain(error)}") from error
        text = " ".join(str(error).split())
        raise PluginError(f"{what} failed, {type(error).__name__}: {text} (HTS_DEBUG=1 shows where).") from error
