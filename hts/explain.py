"""What pydantic found wrong, as one line: which key, what it holds, what was expected, the closest right key."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

from hts.near import nearest

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

Location = tuple[int | str, ...]


EXPECTED: dict[str, str] = {
    "int_parsing": "expected a whole number",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "float_parsing": "expected a number",
    "float_type": "expected a number",
    "bool_parsing": "expected true or false",
    "bool_type": "expected true or false",
    "string_type": "expected text",
    "tuple_type": "expected a list",
    "list_type": "expected a list",
    "dict_type": "expected keys and values",
    "model_type": "expected keys and values",
    "literal_error": "expected {expected}",
    "greater_than": "expected more than {gt:g}",
    "greater_than_equal": "expected at least {ge:g}",
    "less_than": "expected less than {lt:g}",
    "less_than_equal": "expected at most {le:g}",
    "finite_number": "expected a finite number",
    "too_short": "expected at least {min_length}",
    "too_long": "expected at most {max_length}",
}
"""pydantic's type of a fault -> what was expected, with the fault's own numbers; any other keeps pydantic's words."""

SHOWN = 4
"""Faults that are said; more are counted."""


def explain(
    error: ValidationError,
    model: type[BaseModel] | None = None,
    origin: Callable[[Location], str] | None = None,
    also: Sequence[str] = (),
) -> str:
    """One line for everything that is wrong, unknown keys first: they are often why another one is missing.

    model: what was being validated; left out, it is looked up in the error's traceback.
    origin: says of a location where its value was written, e.g. "--set a.b"; default: the location itself.
    also: keys that may stand beside the model's own, since somebody else reads them.
    """
    model = model or validated_model(error)
    faults: list[dict[str, Any]] = [dict(fault) for fault in error.errors(include_url=False)]
    inside = {tuple(fault["loc"][:depth]) for fault in faults for depth in range(len(fault["loc"]))}
    # A list whose items are refused counts as too short: that is no fault of its own.
    faults = [fault for fault in faults if fault["type"] != "too_short" or tuple(fault["loc"]) not in inside]
    faults.sort(key=lambda fault: fault["type"] != "extra_forbidden")
    faults = _one_of_each_choice(faults, model)
    texts = list(dict.fromkeys(_fault(fault, model, origin or dotted, also) for fault in faults))
    text = " Also: ".join(texts[:SHOWN])
    more = len(texts) - SHOWN
    return text + (f" ({more} more thing{'s' if more > 1 else ''} wrong.)" if more > 0 else "")


def _fault(
    fault: Mapping[str, Any], model: type[BaseModel] | None, origin: Callable[[Location], str], also: Sequence[str]
) -> str:
    """One sentence or two about one thing that pydantic found."""
    location: Location = tuple(fault["loc"])
    where = origin(location) if location else ""
    if fault["type"] == "extra_forbidden":
        known = [*(_keys_at(model, location[:-1]) if model else ()), *(also if len(location) == 1 else ())]
        inside = f" in {dotted(location[:-1])}" if location[:-1] else ""
        return f"{where}: there is no key '{location[-1]}'{inside}.{closest(str(location[-1]), known)}"
    if fault["type"] == "missing":
        return f"{where}: this key is needed and missing."
    if fault["type"] == "value_error" and not where:  # of a whole model, whose own words name the key
        return f"{_expected(fault)}."
    if fault["type"] == "value_error" and isinstance(fault["input"], Mapping):  # the rest of a section says nothing
        return f"{where}: {_expected(fault)}."
    given = "nothing" if fault["input"] is None else shortened(fault["input"])
    found = f"{_expected(fault)}, found {given}{_as_whole(fault)}."
    if fault["input"] is None and fault["type"] in ("model_type", "dict_type"):  # all its keys are commented out
        found = f"{_expected(fault)}, found nothing. Write a key below it, or take it away."
    return f"{where}: {found}" if where else found[:1].upper() + found[1:]


def _one_of_each_choice(faults: list[dict[str, Any]], model: type[BaseModel] | None) -> list[dict[str, Any]]:
    """Where a value may be one of several types, pydantic has a fault of each, whose type ends its location: one fault,
    of the value, is made of these. Where only something inside the value is wrong, that is the fault."""
    places: list[Location] = [_without_choices(model, tuple(fault["loc"])) for fault in faults]
    chosen = {place for place, fault in zip(places, faults, strict=True) if place != tuple(fault["loc"])}
    inside = {place[:depth] for place in chosen for depth in range(len(place))}
    found: dict[Any, dict[str, Any]] = {}
    for number, (place, fault) in enumerate(zip(places, faults, strict=True)):
        if place not in chosen:
            found[number] = fault
        elif place in inside:
            continue
        elif place not in found:
            found[place] = {**fault, "loc": place, "expected": [_expected(fault)]}
        elif (words := _expected(fault)) not in found[place]["expected"]:
            found[place]["expected"].append(words)
    return list(found.values())


def _without_choices(annotation: Any, location: Location) -> Location:
    """A location without the names of types among which a value may choose; as it is where nobody knows."""
    if not location:
        return ()
    if get_origin(annotation) is Annotated:
        return _without_choices(get_args(annotation)[0], location)
    step, rest = location[0], location[1:]
    fields, inner = _fields(annotation), get_args(annotation)
    if step in fields:
        return (step, *_without_choices(fields[str(step)].annotation, rest))
    if get_origin(annotation) in (Union, UnionType):
        types = [one for one in inner if one is not NoneType]
        if len(types) == 1:  # or nothing: no choice, and no name in the location
            return _without_choices(types[0], location)
        return _without_choices(next((one for one in types if _is_called(one, str(step))), None), rest)
    if get_origin(annotation) in (list, tuple, dict) and inner:
        each = inner[-1] if get_origin(annotation) is dict else inner[0]
        return (step, *_without_choices(each, rest))
    return location


def _is_called(annotation: Any, name: str) -> bool:
    """Whether pydantic calls a type so: `float`, `constrained-float`, `tuple[int, ...]`, `Named`."""
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    kind = get_origin(annotation) or annotation
    return isinstance(kind, type) and name.partition("[")[0].rpartition("-")[2] == kind.__name__


def _as_whole(fault: Mapping[str, Any]) -> str:
    """How a whole number is written that stands as 1e6, which YAML takes for text."""
    given = fault["input"]
    if fault["type"] != "int_parsing" or not isinstance(given, str):
        return ""
    try:
        number = float(given)
    except ValueError:
        return ""
    return f", write {int(number)}" if number.is_integer() and abs(number) < 2**63 else ""


def _expected(fault: Mapping[str, Any]) -> str:
    """What should stand there, in words that need no Python."""
    if several := fault.get("expected"):
        *most, last = [each.removeprefix("expected ") for each in several]
        return f"expected {', '.join(most)} or {last}" if most else several[0]
    words = EXPECTED.get(fault["type"])
    if words is None:
        return fault["msg"].removeprefix("Value error, ").removeprefix("Input ").removesuffix(".")
    return words.format(**(fault.get("ctx") or {}))


def closest(name: str, known: Sequence[str]) -> str:
    """The end of a sentence about a wrong key: the right one that is near it, if any, then all of them.

    Empty if none are known."""
    if not known:
        return ""
    close = nearest(name, known)
    hint = f" Did you mean '{close}'?" if close is not None else ""
    return f"{hint} Known: {', '.join(sorted(known))}."


def dotted(location: Location) -> str:
    return ".".join(str(part) for part in location)


def shortened(value: Any) -> str:
    """The value as Python writes it, on one line, cut off after 60 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:60] + "…"


def validated_model(error: ValidationError) -> type[BaseModel] | None:
    """The model class that raised. ValidationError knows only its name, the frame that raised knows the class."""
    from pydantic import BaseModel

    trace, model = error.__traceback__, None
    while trace is not None:
        scope = trace.tb_frame.f_locals
        candidate = scope.get("cls", type(scope.get("self")))
        if isinstance(candidate, type) and issubclass(candidate, BaseModel) and candidate.__name__ == error.title:
            model = candidate
        trace = trace.tb_next
    return model


def _fields(model: Any) -> Mapping[str, Any]:
    """The fields of a pydantic model's class; none of anything else."""
    from pydantic import BaseModel

    return model.model_fields if isinstance(model, type) and issubclass(model, BaseModel) else {}


def _keys_at(model: Any, location: Location) -> list[str]:
    """Keys that may stand at a location inside a model; empty where anything may (or nobody knows)."""
    if not location:
        return list(_fields(model))
    step, rest = location[0], location[1:]
    fields = _fields(model)
    if step in fields:
        return _keys_at_annotation(fields[str(step)].annotation, rest)
    return []


def _keys_at_annotation(annotation: Any, location: Location) -> list[str]:
    """As `_keys_at`, through Optional, list, tuple and dict."""
    if _fields(annotation):
        return _keys_at(annotation, location)
    inner = [argument for argument in get_args(annotation) if argument is not Ellipsis]
    for argument in inner:
        # an element of a list or dict uses up one step of the location, a member of a union none
        for rest in (location[1:], location) if location else (location,):
            keys = _keys_at_annotation(argument, rest)
            if keys:
                return keys
    return []
