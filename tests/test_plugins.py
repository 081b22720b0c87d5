"""The registry, tried with packages made inside each test."""

from __future__ import annotations

import re
import subprocess
import sys
from types import SimpleNamespace

import pytest

from hts import hookspecs
from hts.channels import Channel
from hts.contracts import ModelContext, Signals
from hts.errors import ConfigError, PluginError
from hts.factories import CONTRACTS
from hts.plugins import KINDS, load

SIGNALS = Signals((Channel("a", "1"),), Channel("b", "1"), 50.0)
HEAD = "from hts import hookimpl\nHTS_API = 2\n"


THING = """
from hts import contracts
from hts.channels import Channel

class Thing(contracts.{contract}):
    name, unit, inputs, target = {name!r}, "W", ("a",), Channel("b", "W")
    limits = dict(torque_limit=(1.0,), velocity_limit=(1.0,), position_limit=((-1.0, 1.0),))
    spec = contracts.RobotSpec.log_only({name!r}, ("hip",), **limits, rate_hz=50.0)

    def __init__(self, *given):
        self.given = given

Thing.__abstractmethods__ = frozenset()  # it keeps what its factory was given, and no more of the contract
"""


def offering(kind: str, name: str, factory: str = "Thing") -> str:
    thing = THING.format(contract=CONTRACTS[kind].__name__, name=name) if kind in CONTRACTS else ""
    factory = factory if thing else "lambda *given: given"  # a command is whatever may be called
    return f"{HEAD}{thing}\n@hookimpl\ndef hts_{kind}(register):\n    register({name!r}, {factory})\n"


def one_of(kind: str, install, name: str = "thing"):
    install("stranger", {"stranger": offering(kind, name)}, {"stranger": "stranger"})
    return getattr(load(), kind)[name]


def test_hook_objectives(install):
    entry = one_of("objectives", install)
    assert (entry.name, entry.package) == ("thing", "stranger")
    assert load().make_objective("thing", {"a": 1}).given == ({"a": 1},)


def test_hook_measurement_models(install):
    install(
        "made",
        {"made": offering("measurement_models", "mean", "lambda settings, context: dict")},
        {"made": "made"},
    )
    registry = load()
    assert registry.measurement_models["mean"].package == "made"
    with pytest.raises(PluginError, match="'mean' .from made.: its factory gives the class dict itself, not a hts"):
        registry.make_measurement_model("mean", {}, ModelContext(SIGNALS))


def test_hook_robots(install):
    one_of("robots", install)
    assert load().make_robot("thing").given == ({},)


def test_hook_worlds(install):
    one_of("worlds", install)
    assert load().make_world("thing", {"a": 1}, "context").given == ({"a": 1}, "context")


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("", "its class sets no spec, which every robot has."),
        ("spec = {'kp': 1}", "its spec is a dict, expected a hts.contracts.RobotSpec."),
        ("spec = property(lambda self: self.given[1])", "its spec failed, IndexError: "),
    ],
)
def test_a_robot_without_a_spec_is_one_line_with_its_package(install, spec, said):
    source = re.sub(r"spec = contracts.*", spec, offering("robots", "spot"))
    install("lab", {"lab": source}, {"lab": "lab"})
    with pytest.raises(PluginError, match=r"^Robot 'spot' \(from lab\)") as caught:
        load().make_robot("spot")
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_hook_instruments(install):
    one_of("instruments", install)
    assert load().make_instrument("thing", {}, "robot").given == ({}, "robot")


def test_hook_selectors(install):
    one_of("selectors", install)
    assert load().make_selector("thing", {}).given == ({},)


def test_hook_log_readers(install):
    one_of("log_readers", install)
    assert load().make_log_reader("thing").given == ({},)


def test_hook_commands(install):
    assert one_of("commands", install).factory() == ()


def test_every_hook_is_a_kind_of_the_registry_and_has_a_test():
    hooks = {name for name in vars(hookspecs) if name.startswith("hts_")}
    assert hooks == {f"hts_{kind}" for kind in KINDS}
    assert hooks <= {name.replace("test_hook_", "hts_") for name in globals() if name.startswith("test_hook_")}


def test_every_hook_has_a_manual_page():
    for kind in KINDS:
        text = getattr(hookspecs, f"hts_{kind}").__doc__
        assert "register(name, factory)" in text


def test_the_core_comes_in_by_the_same_door():
    registry = load()
    assert {"twin", "field"} <= set(registry.worlds)
    assert registry.worlds["twin"].package == registry.selectors["hierarchical"].package == "hard-to-sim"
    assert registry.log_readers["csv"].package == "hard-to-sim"


def test_two_plugins_of_one_name_stop_with_both_packages_named(install):
    install("first-lab", {"first_lab": offering("robots", "spot")}, {"a": "first_lab"})
    install("second-lab", {"second_lab": offering("robots", "spot")}, {"b": "second_lab"})
    with pytest.raises(PluginError, match=r"robots are named 'spot'.*first-lab.*second-lab"):
        load()


def test_one_plugin_offering_a_name_twice_is_named(install):
    source = offering("robots", "spot") + "    register('spot', dict)\n"
    install("first-lab", {"first_lab": source}, {"a": "first_lab"})
    with pytest.raises(PluginError, match="first-lab offers two robots named 'spot'"):
        load()


def test_a_robot_and_an_objective_may_share_a_name(install):
    source = offering("robots", "heat") + "\n@hookimpl\ndef hts_objectives(register):\n    register('heat', dict)\n"
    install("warm", {"warm": source}, {"warm": "warm"})
    registry = load()
    assert "heat" in registry.robots and "heat" in registry.objectives


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("def (", "SyntaxError"),
        ("raise RuntimeError('two\\nlines')", "RuntimeError: two lines"),
        ("x = 1", "does not say which version of the hooks"),
        ("HTS_API = 99", "stranger was written for version 99 of the hooks, this hts has version 2"),
        ("HTS_API = '2'", "stranger.py: HTS_API is '2', expected a whole number; write HTS_API = 2"),
        # Pluggy alone would accept these two: misspelt, and not marked.
        (HEAD + "@hookimpl\ndef hts_robot(register): pass", "No hook named 'hts_robot'. Did you mean 'hts_robots'?"),
        (HEAD + "def hts_robots(register): pass", "stranger: hts_robots() is not marked as a hook"),
        (HEAD + "@hookimpl(specname='hts_robts')\ndef mine(register): pass", "No hook named 'hts_robts'"),
        (HEAD + "@hookimpl\ndef hts_robots(registry): pass", "hts_robots(registry) cannot be asked: write def hts_rob"),
        (HEAD + "@hookimpl\ndef hts_robots(): pass", "hts_robots() cannot be asked: write def hts_robots(register)"),
        (
            HEAD + "@hookimpl\ndef hts_robots(register): register('spot')",
            "register('spot', None) needs a name and somet",
        ),
        (HEAD + "@hookimpl\ndef hts_robots(register): register('spot', 'no factory')", "something to call"),
        (HEAD + "@hookimpl\ndef hts_robots(register): register('', dict)", "needs a name"),
        (offering("robots", "spot") + "    1 / 0", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_broken_plugin_is_kept_with_its_reason_and_the_others_go_on(install, source, reason):
    install("stranger", {"stranger": source}, {"odd": "stranger"})
    registry = load()
    (broken,) = [broken for broken in registry.broken if broken.package == "stranger"]
    assert broken.entry_point == "odd"
    assert reason in broken.reason
    assert "\n" not in broken.reason
    assert "twin" in registry.worlds


def test_an_entry_point_that_names_more_than_a_module_is_told_so(install):
    install("stranger", {"stranger": offering("robots", "spot")}, {"odd": "stranger:hts_robots"})
    (broken,) = [broken for broken in load().broken if broken.package == "stranger"]
    assert broken.reason.startswith("names 'hts_robots' in stranger, expected the module alone")
    assert 'odd = "stranger"' in broken.reason


def test_what_a_plugin_prints_on_import_is_not_among_what_a_command_prints(install, capsys):
    install("lab", {"lab": HEAD + "print('loading')\n"}, {"lab": "lab"})
    load()
    found = capsys.readouterr()
    assert (found.out, found.err) == ("", "loading\n")


def test_a_hook_may_have_a_name_of_its_own_and_one_of_a_later_hts_may_be_there(install):
    hooks = "@hookimpl(specname='hts_robots')\ndef mine(register):\n    register('spot', dict)\n"
    later = "@hookimpl(optionalhook=True)\ndef hts_of_next_year(register): pass\n"
    install("lab", {"lab": f"{HEAD}{hooks}{later}def hts_helper(): pass\n"}, {"lab": "lab"})
    registry = load()
    assert "spot" in registry.robots and "lab" not in [broken.package for broken in registry.broken]


def test_nothing_is_kept_of_what_a_broken_plugin_offered(install):
    install("stranger", {"stranger": offering("robots", "spot") + "    1 / 0"}, {"odd": "stranger"})
    assert "spot" not in load().robots


def test_an_unknown_name_is_answered_with_the_closest(install):
    install("lab", {"lab": offering("robots", "spot")}, {"lab": "lab"})
    with pytest.raises(ConfigError, match=r"^No robot named 'spto'\. Did you mean 'spot'\?"):
        load().make_robot("spto")


def test_where_nothing_of_a_kind_is_installed_the_line_says_to_install_it():
    with pytest.raises(ConfigError, match=r"^No robot named 'spot'\. Known: none\. Install the package that brings it"):
        load([]).make_robot("spot")


def test_an_unknown_name_points_to_plugins_that_could_not_be_loaded(install):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    with pytest.raises(ConfigError, match="Could not be loaded: stranger; `hts plugins` says why"):
        load().make_objective("heat")


SETTINGS = """
from pydantic import BaseModel, ConfigDict, Field

class Legs(BaseModel):
    model_config = ConfigDict(extra="forbid")
    length: float = Field(1.0, gt=0)

class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    colour: str = "yellow"
    legs: Legs = Legs()

def make(settings):
    return Thing(Settings(**settings))
"""


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"color": "red"}, r"Settings of robot 'spot' \(from lab\): color: .*Did you mean 'colour'\?"),
        ({"legs": {"lenght": 2.0}}, r"legs\.lenght: .*Did you mean 'length'\?"),
        ({"legs": {"length": -2.0}}, r"legs\.length: expected more than 0, found -2\.0"),
    ],
)
def test_wrong_settings_name_the_key_the_package_and_the_closest_key(install, settings, message):
    install("lab", {"lab": offering("robots", "spot", "make") + SETTINGS}, {"lab": "lab"})
    registry = load()
    assert registry.make_robot("spot", {"colour": "red"}).given[0].colour == "red"
    with pytest.raises(ConfigError, match=message):
        registry.make_robot("spot", settings)


def test_loading_the_registry_imports_nothing_heavy():
    code = (
        "import sys\nfrom hts.plugins import load\nregistry = load()\n"
        "print([name for name in ('torch', 'mujoco', 'matplotlib', 'zarr') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_entry_point_without_a_distribution_is_named_by_its_module():
    def fail():
        raise ImportError("gone")

    point = SimpleNamespace(name="x", value="somewhere.plugin", dist=None, load=fail)
    (broken,) = load([point]).broken
    assert (broken.package, broken.reason) == ("somewhere.plugin", "ImportError: gone")


def test_a_plugin_of_the_hooks_before_is_told_what_changed_and_which_line_to_edit(install):
    source = "from hts import hookimpl\n\nHTS_API = 1\n\n@hookimpl\ndef hts_robots(register): pass\n"
    folder = install("old-lab", {"old_lab": source}, {"old": "old_lab"})
    (broken,) = [broken for broken in load().broken if broken.package == "old-lab"]
    assert broken.reason.startswith(
        "old-lab was written for version 1 of the hooks, this hts has version 2; since then "
    )
    assert "measurement_model() returns hts.config.Named" in broken.reason
    assert "a new hook, hts_measurement_models" in broken.reason
    assert broken.reason.endswith(f"then change line 3 of {folder / 'old_lab.py'} to HTS_API = 2")


def test_the_choice_of_a_model_is_not_among_the_settings_of_the_objective(install):
    one_of("objectives", install)
    assert load().make_objective("thing", {"a": 1, "model": {"name": "linear"}}).given == ({"a": 1},)


def test_a_misspelt_choice_of_the_model_is_answered_with_the_key_that_the_core_reads():
    with pytest.raises(ConfigError, match=r"'modl'\. Did you mean 'model'\?"):
        load().make_objective("power", {"modl": "linear"})
