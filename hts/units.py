"""Units of channels and logs: which there are, whether two mean the same quantity, and how to convert.

Those in `UNITS` are known without further ado, everything else that `pint` can read is as good ("K/s", "kg/s", "mA");
pint is imported when one of those turns up, since that takes half a second. A plugin brings a unit of its own by a
definition:

    from hts import units

    units.define("scuff = [wear]")               # a quantity of its own
    units.define("pack = 7.2 * volt")            # or in terms of others, as pint writes it

at the top of the module behind its entry point, so that it is known as soon as the plugin is loaded.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from typing import Any

from hts.errors import RecordingError
from hts.near import nearest

UNITS: dict[str, str] = {
    "1": "dimensionless",
    "s": "seconds",
    "m": "metres",
    "m/s": "metres per second",
    "m/s^2": "metres per second squared",
    "rad": "radians",
    "rad/s": "radians per second",
    "N": "newtons",
    "N*m": "newton metres",
    "A": "amperes",
    "V": "volts",
    "W": "watts",
    "J": "joules",
    "degC": "degrees Celsius",
    "Pa": "pascals",
    "dB(A)": "A-weighted sound level re 20 uPa",
    "%": "per cent",
}
"""Spelling -> what it means. In use since the first stores, and known without pint."""

OWN_NAMES = {"1": "dimensionless", "dB(A)": "decibel_A"}
"""Spellings that pint reads otherwise or not at all -> what it is given instead."""

OUR_DEFINITIONS = ("decibel_A = [sound_level_A]",)  # a level, not a factor: 60 dB(A) is no 10^6 of anything here

TRAPS = {"Nm": "N*m", "mNm": "mN*m", "amps": "A", "rads": "rad"}
"""What people write, alone or in a longer unit -> what they mean. To pint "Nm" is a yarn count, metres per gram, "amps"
are attometres per second, and "rads" a dose of radiation."""

LONGEST = 60  # characters
# A number is only ever an exponent of one digit or the 1 of "1/s": pint computes what it reads,
# and 9**9**9 takes for ever.
TOWER = re.compile(r"\d\d|(\^|\*\*)\s*-?\s*(\d\s*(\^|\*\*)|\()")
DEFINITION = re.compile(r"\s*([^\W\d]\w*)\s*=\s*\S.*")

_defined: dict[str, str] = {}
_kept: set[str] = set()


def define(definition: str) -> None:
    """Make a unit known, in pint's words: "NAME = 3 * OTHER" or "NAME = [quantity]". The same one again is harmless.

    Raises RecordingError if it is not such a line, or its name means something else already.
    """
    match = DEFINITION.fullmatch(definition)
    if match is None:
        raise RecordingError(f"'{definition}' defines no unit. Expected NAME = 3 * OTHER, or NAME = [quantity].")
    name = match[1]
    if _defined.get(name, definition) != definition or name in UNITS:
        raise RecordingError(
            f"The unit '{name}' is defined twice: as '{_defined.get(name, UNITS.get(name))}' and as '{definition}'. "
            "Rename one."
        )
    if name not in _defined:
        _defined[name] = definition
        _registry.cache_clear()
        _parsed.cache_clear()


def keep(unit: str) -> None:
    """Take over a unit as a store has it, also one that a missing plugin defines:
    then it converts to nothing but itself.

    Raises RecordingError for what could never have been one.
    """
    if not known(unit):
        if not unit or len(unit) > LONGEST or not unit.isprintable():
            raise RecordingError(unknown(unit))
        _kept.add(unit)


def known(unit: str) -> bool:
    """Whether it can be the unit of a channel."""
    if unit in UNITS or unit in _kept:
        return True
    try:
        _parsed(unit)
    except RecordingError:
        return False
    return True


def unknown(unit: str) -> str:
    """One line about a unit that is none: the closest one, those that are always there, and how to get others."""
    meant = _words(unit, TRAPS)
    close = meant if meant != unit else nearest(unit, UNITS)
    hint = f" Did you mean '{close}'?" if close else ""
    shown = "".join(letter if letter.isprintable() else "?" for letter in unit[:LONGEST])
    return (
        f"No unit named '{shown}'.{hint} Known: {', '.join(sorted(UNITS))}, others as pint writes them (K/s, kg/s), "
        "and what plugins define (hts.units.define)."
    )


def check(unit: str) -> None:
    """Raises RecordingError for a unit that nobody knows."""
    if not known(unit):
        raise RecordingError(unknown(unit))


def _words(unit: str, instead: Mapping[str, str]) -> str:
    """The unit with other words in the place of some of its own."""
    return re.sub(r"[^\W\d]\w*", lambda word: instead.get(word[0], word[0]), unit)


def conversion(source: str, target: str) -> tuple[float, float]:
    """(scale, offset): a value in `target` is scale · value in `source` + offset.

    Raises RecordingError if one of them is unknown, or they are of different quantities. An angle is one: 1 Hz is not
    1 rad/s, although both are 1/s in SI. Nor is degC or degF converted to K, which may be a rise and must not
    gain 273 K, nor delta_degC to degC. K become degC: a channel in degC is of a temperature.
    """
    if source == target:
        return 1.0, 0.0
    first, second = _parsed(source), _parsed(target)
    registry = _registry()
    same = registry.get_root_units(first)[1] == registry.get_root_units(second)[1]
    of_heat = same and first.dimensionality == {"[temperature]": 1} and first != registry.kelvin
    if of_heat and _is_temperature(first) != _is_temperature(second):
        raise RecordingError(
            f"{source} cannot be converted to {target}: a temperature and a rise of temperature would become different "
            "numbers, and nothing says which of them this is. Of a rise, write a rise in K or delta_degC on both "
            "sides; of a temperature, write degC on both, or convert it by hand (`offset` in a log's mapping)."
        )
    if same:
        at = [float(registry.Quantity(value, first).to(second).magnitude) for value in (0.0, 1.0, 2.0)]
        scale, offset = at[1] - at[0], at[0]
        if abs(at[2] - offset - 2 * scale) <= 1e-9 * abs(scale):  # a logarithmic unit is no factor of another
            return scale, offset
    raise RecordingError(f"{source} cannot be converted to {target}: they are units of different quantities.")


def one_quantity(first: str, second: str) -> bool:
    """Whether numbers in one unit can be written in the other; False for units that nobody knows."""
    try:
        conversion(first, second)
    except RecordingError:
        return False
    return True


def same_unit(first: str, second: str) -> bool:
    """Whether a number means the same in both, which may be one unit that is spelled in two ways."""
    return one_quantity(first, second) and conversion(first, second) == (1.0, 0.0)


def is_temperature(unit: str) -> bool:
    """Whether it is of a temperature that counts from an arbitrary zero, degC or degF: the ratio of two of those says
    nothing, their difference does. False for K, which may be a rise, and for units that nobody knows."""
    if unit in UNITS:
        return unit == "degC"
    try:
        parsed = _parsed(unit)
    except RecordingError:
        return False
    return bool(parsed.dimensionality == {"[temperature]": 1}) and _is_temperature(parsed)


def _is_temperature(unit: Any) -> bool:
    """Whether it counts from a zero of its own, as degC does: a temperature, where K may be a rise of one, too."""
    return bool(_registry().Quantity(0.0, unit).to_root_units().magnitude != 0.0)


@functools.cache
def _registry() -> Any:
    """pint's registry with our definitions and those of plugins.
    Raises RecordingError for a definition it cannot read."""
    import pint

    registry: Any = pint.UnitRegistry()
    for definition in (*OUR_DEFINITIONS, *_defined.values()):
        name = definition.partition("=")[0].strip()
        try:
            if name in registry:
                raise ValueError(f"'{name}' is a unit already: {registry.Unit(name):~P}")
            registry.define(definition)
            registry.get_root_units(registry.parse_units(name))
        except Exception as error:  # pint raises what its parser, tokenizer or arithmetic happens to raise
            raise RecordingError(f"The unit definition '{definition}' cannot be used ({error}).") from error
    return registry


@functools.cache
def _parsed(unit: str) -> Any:
    """pint's unit of that spelling. Raises RecordingError if it is none."""
    text = OWN_NAMES.get(unit, unit)
    if not text or len(text) > LONGEST or _words(unit, TRAPS) != unit or TOWER.search(text) or not text.isprintable():
        raise RecordingError(unknown(unit))
    registry = _registry()
    try:
        parsed = registry.parse_units(text)
        registry.get_root_units(parsed)
    except Exception as error:  # pint raises what its parser, tokenizer or arithmetic happens to raise
        raise RecordingError(unknown(unit)) from error
    return parsed
