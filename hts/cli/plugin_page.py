"""`hts plugins NAME`: all of one plugin on a page, its settings, and for a robot its channels with their units."""

from __future__ import annotations

import dataclasses
import json
import shutil
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hts.channels import Channel
from hts.contracts import Objective
from hts.errors import ConfigError, HtsError, unknown_name
from hts.plugin_settings import WITH_SETTINGS, settings_model, settings_of
from hts.plugins import KINDS, Registry

Data = dict[str, Any]

WHERE = {
    "objectives": "objectives.{name}.",
    "measurement_models": "objectives.OBJECTIVE.model.",
    "robots": "robot.",
    "worlds": "world.",
    "instruments": "world.instruments.{name}.",
    "selectors": "selection.selector.",
}
"""Kind -> what stands before a setting's key in a config file and in --set; log readers are set by their mapping."""


def plugin_data(registry: Registry, name: str) -> list[Data]:
    """Everything of that name, whatever its kind. Raises ConfigError with the closest name."""
    kinds = [kind for kind in KINDS if name in registry.offered(kind)]
    if not kinds:
        known = {one for kind in KINDS for one in registry.offered(kind)}
        raise ConfigError(unknown_name("plugin", name, known) + registry.not_loaded())
    return [_data(registry, kind, name) for kind in kinds]


def _data(registry: Registry, kind: str, name: str) -> Data:
    entry = registry.entry(kind, name)
    data: Data = {
        "kind": KINDS[kind],
        "name": name,
        "package": entry.package,
        "about": " ".join((entry.factory.__doc__ or "").split()),
    }
    if kind in WITH_SETTINGS:
        model = settings_model(registry, kind, name)
        data["settings_key"] = WHERE.get(kind, "").format(name=name)
        data["settings"] = None
        if model is not None:
            data["settings"] = [
                {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}
                for one in settings_of(model)
            ]
    try:
        data |= _more(registry, kind, name)
    except HtsError as error:  # one that needs settings: its page says so, and lists them
        data["fault"] = str(error)
    return data


def _more(registry: Registry, kind: str, name: str) -> Data:
    """What only things of this kind have."""
    if kind == "robots":
        robot = registry.make_robot(name)
        spec = robot.spec
        return {
            "facts": {
                "joints": list(spec.joint_names),
                "control rate": f"{spec.control_rate_hz:g} Hz",
                "physics step": f"{spec.physics_dt:g} s",
            },
            "channels": [_channel(channel) for channel in robot.channels().values()],
            "real_channels": _real_channels(registry),
        }
    if kind == "objectives":
        objective = registry.make_objective(name)
        from_data = type(objective).weights_for is not Objective.weights_for
        return {
            "facts": {
                "inputs": list(objective.inputs),
                "target": objective.target.name,
                "also measured": [channel.name for channel in objective.also_measured],
                "instrument": objective.instrument,
                "improvement in": "a fraction" if objective.unit == "1" else objective.unit,
                "λ": list(objective.weights),
                **({"λ behind a fitted model": "from its data, where the settings name none"} if from_data else {}),
                "λ of the baseline": list(objective.baseline_weights),
                "λ with --reward proxy": list(objective.proxy_weights or objective.baseline_weights),
            },
            "channels": [_channel(channel) for channel in objective.real_channels],
        }
    if kind == "instruments" and registry.robots:
        instrument = registry.make_instrument(name, {}, registry.make_robot(min(registry.robots)))
        return {"channels": [_channel(channel) for channel in instrument.channels]}
    return {}


def _real_channels(registry: Registry) -> list[Data]:
    """What only the real robot gives, as far as installed objectives and instruments ask for it or measure it."""
    rows: dict[str, Data] = {}
    for name in sorted(registry.objectives):
        try:
            objective = registry.make_objective(name)
        except HtsError:  # one that needs settings: its own page says so
            continue
        for channel in objective.real_channels:
            row = rows.setdefault(channel.name, {**_channel(channel), "for": []})
            row["for"].append(f"{'target of' if channel is objective.target else 'also scored by'} {name}")
    for name in sorted(registry.instruments):
        try:
            instrument = registry.make_instrument(name, {}, registry.make_robot(min(registry.robots)))
        except HtsError:
            continue
        for channel in instrument.channels:
            rows.setdefault(channel.name, {**_channel(channel), "for": []})["for"].append(f"measured by {name}")
    return list(rows.values())


def _channel(channel: Channel) -> Data:
    return {
        "name": channel.name,
        "unit": channel.unit,
        "shape": list(channel.shape),
        "description": channel.description,
    }


def plugin_text(pages: Sequence[Data]) -> str:
    """The pages as text, as wide as the terminal."""
    width = max(60, min(120, shutil.get_terminal_size().columns))
    return "\n\n".join("\n".join(_lines(page, width)) for page in pages)


def _lines(page: Data, width: int) -> Iterable[str]:
    yield f"{page['kind']} {page['name']} ({page['package']})"
    yield from textwrap.wrap(page["about"], width, initial_indent="  ", subsequent_indent="  ")
    for key, value in page.get("facts", {}).items():
        shown = ", ".join(map(str, value)) if isinstance(value, list) else value
        yield from textwrap.wrap(f"{key}: {shown or 'none'}", width, initial_indent="  ", subsequent_indent="    ")
    if "fault" in page:
        yield from textwrap.wrap(page["fault"], width, initial_indent="  ", subsequent_indent="  ")
    yield from _channel_lines(
        "channels" if "real_channels" not in page else "channels of simulation and robot", page.get("channels"), width
    )
    yield from _channel_lines(
        "channels of the robot alone, which installed objectives want measured", page.get("real_channels"), width
    )
    if "settings" in page:
        yield from _setting_lines(page, width)


def _channel_lines(title: str, rows: Sequence[Data] | None, width: int) -> Iterable[str]:
    if not rows:
        return
    yield ""
    yield title
    names = max(len(row["name"]) for row in rows)
    units = max(len(row["unit"]) for row in rows)
    for row in rows:
        shape = "×".join(map(str, row["shape"])) or "–"
        about = "; ".join(filter(None, [row["description"], ", ".join(row.get("for", ()))]))
        head = f"  {row['name']:<{names}}  {row['unit']:<{units}}  {shape:>4}  "
        yield from textwrap.wrap(about, width, initial_indent=head, subsequent_indent=" " * len(head)) or [
            head.rstrip()
        ]


def _setting_lines(page: Data, width: int) -> Iterable[str]:
    yield ""
    if page["settings"] is None:
        yield "settings: not known; it has none, or does not check them by a pydantic model"
        return
    if not page["settings"]:
        yield "settings: none"
        return
    key = page["settings_key"]
    yield f"settings, --set {key}KEY=VALUE" if key else "settings"
    for row in page["settings"]:
        default = "needed" if row["needed"] else _yaml(row["default"])
        head = f"  {row['key']}: {default}"
        kind = ", ".join(filter(None, [row["type"], row["bounds"]]))
        if len(head) + len(kind) + 4 <= width:
            yield f"{head}  ({kind})"
        else:
            yield head
            yield from textwrap.wrap(f"({kind})", width, initial_indent="      ", subsequent_indent="      ")
        yield from textwrap.wrap(row["description"], width, initial_indent="      ", subsequent_indent="      ")


def _yaml(value: Any) -> str:
    if isinstance(value, (Mapping, list, str, bool, int, float)) or value is None:
        return json.dumps(value, ensure_ascii=False)
    return str(value)
