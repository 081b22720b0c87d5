"""The kit for plugin authors, tried on our own plugins, on what `hts new` writes, and on faulty ones."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hts.errors import ConfigError, RunError
from hts.plugins import load
from hts.testing.conformance import check_package
from hts.testing.starters import write_starter

OURS = ["hard-to-sim", "hard-to-sim-power", "hard-to-sim-noise", "hard-to-sim-go1"]


def faults(package: str) -> dict[str, str]:
    """Subject and demand -> fault, of everything that is not kept."""
    return {f"{f.subject}: {f.demand}": f.fault for f in check_package(load(), package) if f.fault is not None}


@pytest.mark.parametrize("package", OURS)
def test_our_own_plugins_keep_the_contracts(package):
    assert faults(package) == {}


def test_a_package_that_is_not_installed_is_answered_with_the_closest():
    with pytest.raises(ConfigError, match="Did you mean 'hard-to-sim'"):
        check_package(load(), "hard-to-simm")


def test_a_broken_package_is_a_finding(install):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    assert list(faults("stranger").values()) == ["ModuleNotFoundError: No module named 'no_such_library'"]
