"""A plugin that breaks only when it is made: one line with its package wherever it is asked for, and no other suffers.

The package is what `hts new objective` writes, with one text replaced.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.errors import PluginError
from hts.factories import CONTRACTS, made_by
from hts.plugins import load
from hts.testing.packages import write_package
from hts.testing.starters import write_starter

NO_IMPORT = ("objective.py", "from pydantic import Field", "from pydantic import Feld as Field")
RAISES = ("plugin.py", "    return objective.Heat(", "    settings['no_such_key']\n    return objective.Heat(")
GIVES_NONE = ("plugin.py", "    return objective.Heat(", "    objective.Heat(")
GIVES_A_CLASS = ("plugin.py", "objective.Heat(objective.Settings(**settings))", "objective.Heat")
NO_METHOD = ("objective.py", "    def compare(self", "    def compar(self")
OTHER_NAME = ("objective.py", '    name = "heat"', '    name = "warmth"')
INPUT_TWICE = (
    "objective.py",
    "    target = TARGET\n",
    "    target = TARGET\n    inputs = ('joint_torque', 'joint_torque')\n",
)
ONE_INPUT = ("objective.py", "    target = TARGET\n", "    target = TARGET\n    inputs = 'joint_torque'\n")
NO_TUPLE = ("objective.py", "    target = TARGET\n", "    target = TARGET\n    also_measured = TARGET\n")
NO_BASE = ("objective.py", "class Heat(Objective):", "class Heat:")
NO_UNIT = ("objective.py", '    unit = "1"', '    unit = "percentage"')
UNIT_IS_NO_TEXT = ("objective.py", '    unit = "1"', "    unit = 1")
UNIT_OF_METRIC = ("objective.py", '    unit = "1"', '    unit = "1"\n    metric_units = {"net": "wats"}')
UNITS_OF_METRICS = ("objective.py", '    unit = "1"', '    unit = "1"\n    metric_units = ("net", "W")')
NO_TARGET = ("objective.py", "    target = TARGET\n", "")
FAULTS = {
    "a misspelt import": (NO_IMPORT, "ImportError: cannot import name 'Feld' from 'pydantic'"),
    "a factory that raises": (RAISES, "KeyError: 'no_such_key'"),
    "a factory that gives None": (GIVES_NONE, "its factory gives a NoneType, not a hts.contracts.Objective"),
    "a factory that gives a class": (GIVES_A_CLASS, "its factory gives the class Heat itself"),
    "a method that is missing": (NO_METHOD, "abstract class Heat"),
    "a name that is not the registered one": (
        OTHER_NAME,
        "calls itself 'warmth', expected the registered name, 'heat'",
    ),
    "an input twice": (INPUT_TWICE, "inputs are joint_torque, joint_torque, expected each channel once"),
    "an input that is no tuple": (ONE_INPUT, "inputs are 'joint_torque', expected names of channels, such as"),
    "a channel that is no tuple": (NO_TUPLE, "also_measured is a Channel, expected a tuple of hts.channels.Channel"),
    "a class that does not derive": (NO_BASE, "its factory gives a Heat, not a hts.contracts.Objective"),
    "a unit that nobody knows": (NO_UNIT, "unit: No unit named 'percentage'. Known: "),
    "a unit that is no text": (UNIT_IS_NO_TEXT, "unit is 1, expected text, such as '1' for a fraction"),
    "a metric in a unit that nobody knows": (UNIT_OF_METRIC, "metric_units of 'net': No unit named 'wats'. Known: "),
    "units of metrics that are no mapping": (UNITS_OF_METRICS, "metric_units are ('net', 'W'), expected names with"),
    "a target that is missing": (NO_TARGET, "its class sets no target"),
}


@pytest.fixture
def broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """broken(file, before, after): the package lab-heat with objective `heat`, one text replaced, found by hts."""

    def made(file: str = "", before: str = "", after: str = "") -> None:
        folder = write_starter("objective", "heat", tmp_path / "lab")
        write_package(folder, "lab-heat", {}, {"heat": "hts_heat.plugin"})
        if file:
            place = folder / "hts_heat" / file
            text = place.read_text()
            assert before in text
            place.write_text(text.replace(before, after))
        monkeypatch.syspath_prepend(str(folder))

    yield made
    for name in [name for name in sys.modules if name.split(".")[0] == "hts_heat"]:
        del sys.modules[name]


@pytest.fixture
def line(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """line(*arguments) -> the one line of a command that is refused."""

    def line(*arguments: object) -> str:
        capsys.readouterr()
        assert main([str(one) for one in arguments]) == 2
        err = capsys.readouterr().err
        assert err.startswith("error: ") and err.count("\n") == 1, err
        return err

    return line


@pytest.mark.parametrize("what", FAULTS)
def test_it_is_named_with_its_package_wherever_it_is_asked_for(broken, line, tmp_path, what):
    fault, said = FAULTS[what]
    broken(*fault)
    (tmp_path / "m.yaml").write_text("reader: csv\n")
    for words in (
        ("run", "--objective", "heat", "--robot", "go1", "--preset", "smoke", "--dry-run", "--out", tmp_path / "run"),
        ("config", "show", "--objective", "heat", "--robot", "go1"),
        ("data", "enough", tmp_path / "no.zarr", "--objective", "heat"),
        ("import", "a.csv", "--robot", "go1", "--mapping", tmp_path / "m.yaml", "--dry-run", "--objective", "heat"),
        ("fit", "--objective", "heat", "--data", tmp_path / "no.zarr", "--out", tmp_path / "fit"),
    ):
        found = line(*words)
        if words[0] == "fit" and "no.zarr" in found:
            continue  # the store is opened first
        assert "Objective 'heat' (from lab-heat)" in found and said in found, found
        assert "pip uninstall lab-heat" in found


@pytest.mark.parametrize("what", FAULTS)
def test_the_pages_list_it_with_its_reason_and_are_whole_for_all_others(broken, capsys, what):
    fault, said = FAULTS[what]
    broken(*fault)
    assert main(["plugins", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    (row,) = [row for row in data["broken"] if row["package"] == "lab-heat"]
    assert row["entry_point"] == "objective 'heat'" and said in row["reason"]
    assert "heat" not in {one["name"] for one in data["objectives"]}
    assert {"power", "noise"} <= {one["name"] for one in data["objectives"]}
    assert main(["plugins", "go1"]) == 0
    page = capsys.readouterr().out
    assert "target of power" in page
    assert main(["plugins", "heat"]) == 0
    assert said.split(":")[0] in " ".join(capsys.readouterr().out.split())


def test_a_sound_one_is_listed_as_before(broken, capsys):
    broken()
    assert main(["plugins", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert "heat" in {one["name"] for one in data["objectives"]} and data["broken"] == []


KINDS_MADE = {"robots": (), "worlds": (None,), "instruments": (None,), "selectors": (), "log_readers": ()}


@pytest.mark.parametrize("kind", KINDS_MADE)
def test_a_class_that_does_not_derive_from_its_contract_is_named_whatever_its_kind(kind):
    class Stranger:
        def __init__(self, *given):
            pass

    contract = CONTRACTS[kind].__name__
    with pytest.raises(PluginError, match=rf"gives a Stranger, not a hts\.contracts\.{contract}\. Mend lab"):
        made_by(Stranger, kind, "thing 'odd'", "odd", "lab", {}, *KINDS_MADE[kind])


def test_what_is_not_made_by_its_own_name_breaks_no_check_of_others(broken):
    broken(*NO_IMPORT)
    from hts.testing.checks.fitted_models import context_for
    from hts.testing.checks.made_up import case_for
    from hts.testing.packages import kit_installed

    with kit_installed():
        registry = load()
        context_for(registry.measurement_models["linear"], registry)
        case_for(registry.worlds["twin"], registry)


# ---------------------------------------------------------------------------------------------------------------- λ


@pytest.mark.parametrize("key", ["weights", "baseline_weights"])
@pytest.mark.parametrize("wrong", ["[-1]", "[.nan]", "[.inf]", "[1.0, -0.5]"])
@pytest.mark.parametrize("template", ["as it is written", "that takes anything"])
def test_weights_below_zero_or_without_a_value_are_refused(broken, line, tmp_path, key, wrong, template):
    if template == "that takes anything":
        broken("objective.py", "Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]", "Weight = float")
    else:
        broken()
    said = line(
        *("run", "--objective", "heat", "--robot", "go1", "--preset", "smoke", "--dry-run"),
        *("--set", f"objectives.heat.{key}={wrong}", "--out", tmp_path / "run"),
    )
    assert "heat' (from lab-heat)" in said and key in said
    assert "at least 0" in said or "finite" in said


@pytest.mark.parametrize("name", ["power", "noise"])
def test_our_own_objectives_refuse_them_in_the_words_of_their_settings(name):
    from hts.errors import ConfigError

    with pytest.raises(ConfigError, match=r"baseline_weights\.0: expected at least 0, found -1\.0"):
        load().make_objective(name, {"baseline_weights": [-1.0]})


def test_the_refusal_of_the_sweep_says_what_is_wrong_and_nothing_else(line, tmp_path):
    said = line(
        *("run", "--objective", "power", "--robot", "go1", "--preset", "smoke", "--out", tmp_path / "run"),
        *("--set", "sweep.weights.power=[-1]"),
    )
    assert "weights.power: -1.0 is not a number of at least 0" in said and "kl_bounds" not in said
