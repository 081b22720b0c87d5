"""Units: what can be one, what converts to what, and what a plugin brings."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from hts import units
from hts.channels import Channel
from hts.errors import RecordingError
from hts.testing.packages import write_package


@pytest.fixture
def no_definitions():
    """Whatever the test defines or keeps is forgotten after it."""
    yield
    units._defined.clear()
    units._kept.clear()
    units._registry.cache_clear()
    units._parsed.cache_clear()


@pytest.mark.parametrize("unit", [*units.UNITS, "K/s", "kg/s", "mA", "deg/s", "rpm", "kPa", "1/s", "kg*m^2", "N·m"])
def test_a_channel_may_have_this_unit(unit):
    assert Channel("x", unit).unit == unit


@pytest.mark.parametrize(
    "unit",
    [
        "",
        "Amps",
        "m/",
        "2*m",
        "metre pro Stunde",
        "Nm",
        "9**9**9",
        "9^(9^9)",
        "10**9",
        "__import__('os')",
        "m\n",
        "x" * 500,
    ],
)
def test_a_channel_may_not_have_this_unit(unit):
    with pytest.raises(RecordingError, match="Channel 'x': No unit named"):
        Channel("x", unit)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("Nm", "N*m"),  # to pint a yarn count, metres per gram
        ("Nm/rad", "N*m/rad"),
        ("mNm", "mN*m"),
        ("amps", "A"),  # to pint attometres per second
        ("rads", "rad"),  # to pint a dose of radiation
        ("rads/s", "rad/s"),
    ],
)
def test_what_people_write_is_not_taken_for_what_else_has_that_name(written, meant):
    with pytest.raises(RecordingError) as caught:
        units.check(written)
    assert f"No unit named '{written}'. Did you mean '{meant}'?" in str(caught.value)
    units.check(meant)


@pytest.mark.parametrize(
    ("source", "target", "scale", "offset"),
    [
        ("N*m", "N*m", 1.0, 0.0),
        ("mA", "A", 0.001, 0.0),
        ("deg", "rad", math.pi / 180, 0.0),
        ("rpm", "rad/s", 2 * math.pi / 60, 0.0),
        ("degC", "degF", 1.8, 32.0),
        ("K", "degC", 1.0, -273.15),
        ("K/min", "K/s", 1 / 60, 0.0),
        ("degC/s", "K/s", 1.0, 0.0),
        ("%", "1", 0.01, 0.0),
        ("g/s", "kg/s", 0.001, 0.0),
    ],
)
def test_a_unit_converts(source, target, scale, offset):
    assert units.conversion(source, target) == (pytest.approx(scale), pytest.approx(offset))


@pytest.mark.parametrize(
    ("source", "target"), [("Hz", "rad/s"), ("1", "rad"), ("W", "J"), ("dB(A)", "1"), ("dB(A)", "Pa"), ("dB", "1")]
)
def test_units_of_different_quantities_do_not_convert(source, target):
    with pytest.raises(RecordingError, match="different quantities"):
        units.conversion(source, target)


@pytest.mark.parametrize(("source", "target"), [("delta_degC", "K"), ("K", "delta_degC"), ("delta_degC", "mK")])
def test_a_rise_of_temperature_gains_nothing(source, target):
    assert units.conversion(source, target)[1] == 0.0


@pytest.mark.parametrize(
    ("source", "target"),
    [("degC", "K"), ("delta_degC", "degC"), ("degF", "K"), ("degC", "delta_degC"), ("delta_degC", "degF")],
)
def test_what_may_be_a_temperature_or_a_rise_is_not_converted(source, target):
    with pytest.raises(RecordingError) as refused:
        units.conversion(source, target)
    said = str(refused.value)
    assert said.startswith(f"{source} cannot be converted to {target}: a temperature and a rise of temperature would")
    assert "write a rise in K or delta_degC on both sides" in said and "\n" not in said


def test_a_plugin_brings_a_unit_by_a_line(no_definitions):
    units.define("pack = 7.2 * volt")
    units.define("sone = [loudness]")
    units.define("sone = [loudness]")  # its module may be loaded twice
    assert units.conversion("pack", "V") == (pytest.approx(7.2), pytest.approx(0.0))
    assert units.conversion("sone/s", "sone/min") == (pytest.approx(60.0), pytest.approx(0.0))
    with pytest.raises(RecordingError, match="different quantities"):
        units.conversion("sone", "dB(A)")


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        ("sone", "defines no unit"),
        ("3 = sone", "defines no unit"),
        ("A = 3 * volt", "'A' is defined twice"),
        ("meter = 3 * foot", "is a unit already"),
        ("sone = 3 * loudnezz", "cannot be used"),
    ],
)
def test_a_definition_that_cannot_be_is_named(no_definitions, definition, words):
    with pytest.raises(RecordingError, match=words):  # noqa: PT012 - either of the two may say it
        units.define(definition)
        units.conversion("mA", "A")


def test_two_plugins_may_not_mean_different_things_by_one_unit(no_definitions):
    units.define("pack = 7.2 * volt")
    with pytest.raises(RecordingError, match="'pack' is defined twice: as 'pack = 7.2.*' and as 'pack = 3.6"):
        units.define("pack = 3.6 * volt")


def test_a_recording_opens_where_the_plugin_of_its_unit_is_missing(no_definitions):
    units.keep("wug/s")
    assert Channel("x", "wug/s").unit == "wug/s"
    assert units.conversion("wug/s", "wug/s") == (1.0, 0.0)
    with pytest.raises(RecordingError, match="No unit named 'wug/s'"):
        units.conversion("wug/s", "A")


def test_usual_channels_need_no_pint():
    code = (
        "import sys; from hts.channels import standard_channels; "
        "standard_channels(12, 4); sys.exit('pint' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_temperatures_count_from_an_arbitrary_zero_and_rises_do_not():
    assert all(units.is_temperature(unit) for unit in ("degC", "degF"))
    assert not any(units.is_temperature(unit) for unit in ("K", "delta_degC", "K/s", "A", "mA", "dB(A)", "dB", "none"))


def test_a_plugins_unit_is_there_once_it_is_loaded(tmp_path):
    source = "from hts import units\nHTS_API = {version}\nunits.define('sone = [loudness]')\n"
    from hts.hookspecs import API_VERSION

    write_package(tmp_path, "hts-loud", {"hts_loud.py": source.format(version=API_VERSION)}, {"loud": "hts_loud"})
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from hts.plugins import load; from hts.channels import Channel\n"
        "assert not load().broken; Channel('loudness', 'sone')"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
