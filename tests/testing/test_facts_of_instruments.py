"""What an instrument says of its numbers, and of what a reality must agree with: mistakes in it are one line."""

from __future__ import annotations

import pytest

from hts.contracts import Fact, Instrument, parameter, parameters
from hts.errors import PluginError
from hts.plugins import Entry, Registry
from hts.testing.checks.facts import facts_can_be_read
from hts.testing.checks.instruments import knows_idle, reads_its_channels
from hts.testing.examples.instrument.instrument import Settings, Warmth
from hts.worlds.realities.read_off import read_off

(NAME,) = (channel.name for channel in Warmth.channels)


def entry(**methods: object) -> Entry:
    """The kit's example of an instrument, with some of it replaced."""
    kind = type("Odd", (Warmth,), methods)
    return Entry("odd", lambda settings, robot: kind(Settings()), "lab")


def fact(**changes: object) -> dict[str, object]:
    about = {"name": "walking", "speed": 0.5, "low": 1.0, "high": 9.0, "unit": "W", "source": "E"}
    told = Fact(**{"reading": lambda channels, idle: float(channels[NAME].mean()), **about, **changes})
    return {"facts": lambda self: [told]}


def test_a_sound_fact_is_read():
    facts_can_be_read(entry(**fact()), Registry())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"unit": "wats"}, "fact 'walking': No unit named 'wats'"),
        ({"low": 10.0}, "fact 'walking': its bounds are 10 to 9, expected the lower one first"),
        ({"speed": -0.5}, "fact 'walking': its speed is -0.5, expected m/s of at least 0"),
        (
            {"reading": lambda channels, idle: channels["no"].mean()},
            r"Fact 'walking': reading\(\) failed, KeyError: 'no'",
        ),
        ({"reading": lambda channels, idle: channels[NAME]}, "gives a ndarray, expected one number"),
        ({"reading": lambda channels, idle: float("nan")}, "reads nan of a recording of finite numbers"),
    ],
)
def test_a_fact_that_no_reality_could_be_held_against_is_said(changes, said):
    with pytest.raises(PluginError, match=said):
        facts_can_be_read(entry(**fact(**changes)), Registry())


def test_a_fact_that_fails_on_a_draw_is_a_mistake_of_its_package_and_drops_none():
    """A dropped draw would be followed by the next one, without end."""
    told = fact(reading=lambda channels, idle: channels["no"].mean())["facts"](None)[0]
    with pytest.raises(PluginError, match=r"Fact 'walking': reading\(\) failed, KeyError: 'no'"):
        read_off(told, {}, {})


@pytest.mark.parametrize(
    ("methods", "check", "said"),
    [
        ({"channels": Warmth.channels[0]}, reads_its_channels, "its channels are a Channel, expected a tuple of hts"),
        ({"read": lambda self: self.kelvin}, reads_its_channels, r"read\(\) gives a ndarray, expected readings by"),
        ({"idle": lambda self: None}, knows_idle, r"idle\(\) gives a NoneType, expected levels by the names"),
        (
            {"idle": lambda self: {NAME: [5.0]}},
            knows_idle,
            "the idle level of '.*' is a list, expected one number",
        ),
    ],
)
def test_an_answer_of_another_kind_is_said(methods, check, said):
    with pytest.raises(PluginError, match=said):
        check(entry(**methods), Registry())


def test_an_instrument_without_channels_is_told_so():
    class Bare(Instrument):
        reset = step = read = idle = lambda self, *given: {}

    with pytest.raises(PluginError, match="its class sets no channels, a tuple of hts.channels.Channel"):
        reads_its_channels(Entry("bare", lambda settings, robot: Bare(), "lab"), Registry())


@pytest.mark.parametrize(
    ("given", "more", "said"),
    [
        ((65.0, 15.0, 60.0), {}, "parameter 'heat': its default is 65, outside its range 15 to 60"),
        ((35.0, 60.0, 15.0), {}, "parameter 'heat': its range is 60 to 15, expected the lower end first"),
        ((35.0, 15.0, 60.0), {"drawn": (10.0, 20.0)}, "parameter 'heat': drawn is 10, outside its range 15 to 60"),
        ((35.0, 15.0, 60.0), {"drawn": (50.0, 20.0)}, "parameter 'heat': drawn is 50 to 20, expected the lower end"),
    ],
)
def test_a_parameter_outside_its_own_range_is_refused_where_it_is_written(given, more, said):
    with pytest.raises(PluginError, match=said):
        parameter(*given, "degC", "E", "heat", **more)
    default, *ends = given
    with pytest.raises(PluginError, match=said):
        parameters((default,), *ends, "degC", "E", "heat", counts=(1, 3), **more)
