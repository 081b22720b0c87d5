"""A mapping to begin with, made from a log's header and first values. What these do not tell is marked CHECK."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hts.channels import Channel
from hts.contracts import FollowVelocity, Objective, Robot
from hts.errors import RecordingError
from hts.recordings.glance import Glance, glance
from hts.units import one_quantity

CHECK = "CHECK"
TIMES = {"t", "time", "timestamp", "stamp", "timestamps", "log", "sec", "secs", "seconds", "clock"}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
QUANTITIES: dict[str, tuple[str, set[str]]] = {
    "joint_target": ("rad", {"target", "targets", "cmd", "command", "des", "desired", "goal", "action"}),
    "joint_velocity": ("rad/s", {"dq", "qd", "rate", "vel", "velocity", "velocities", "speed", "omega"}),
    "joint_torque": ("N*m", {"tau", "torque", "torques", "effort", "moment", "trq"}),
    "joint_position": ("rad", {"q", "pos", "position", "positions", "angle", "angles"}),
}
"""Channel -> its usual unit, and the words that name it; the first that fits is taken."""
DEGREES = {"deg", "degrees", "degree", "dps"}
OTHER_UNITS = {"rpm": ("rad/s", "rpm"), "mnm": ("N*m", "mN*m")}
"""Word of a joint's column -> the usual unit, and the one that the word says instead."""
GAUGES: dict[str, set[str]] = {
    "A": {"a", "amp", "amps", "ampere", "amperes", "current"},
    "V": {"v", "volt", "volts", "voltage"},
    "W": {"w", "watt", "watts"},
}
MILLI = {"ma": "mA", "mv": "mV", "mw": "mW"}
SYMBOL = re.compile(r"([IUP])_(?!gain|term|error)[A-Za-z]")
"""Of a name such as U_main: the letter of the quantity in a formula."""
SYMBOLS = {"I": "A", "U": "V", "P": "W"}
BETWEEN = (".", "-", " ", "/")
"""What may stand in a log's names where the robot's have `_`."""
SELDOM = 0.75
"""Share of the rows in which a gauge shows something, below which it is slower than the log around it."""
NOT_MEANS = {"std", "max", "min", "var", "target", "desired", "raw"}


def suggested_mapping(path: Path, robot: Robot, objectives: Sequence[Objective] = ()) -> str:
    """YAML of a mapping for logs like this one. It is not importable before what is marked was answered: idle levels,
    and a time column or joint channels where none was recognised. Raises RecordingError for a file that cannot be read.

    objectives: a gauge gets the name of what they measure where it is the only one in such a unit, and so does a column
    that is called so, of whatever quantity; what they need and the log does not show is listed.
    """
    seen = glance(path)
    columns = _flat(seen.columns)
    if not any(np.isfinite(values).any() for values in columns.values()):
        raise RecordingError(f"{path}: no column of numbers in it. Write its mapping by hand.")
    time, unit, rate = _time(seen, columns)
    lines = [
        f"# Suggested for {path.name} and robot {robot.spec.name}. Look at every line; answer each {CHECK}.",
        *([f"reader: {seen.reader}"] if seen.reader != "csv" else []),
        *(f"{key}: {json.dumps(value)}" for key, value in seen.keys.items() if key != "rate_hz"),
    ]
    note = "" if time is not None else f"  # {CHECK}: no column of increasing times was recognised"
    name = f"{CHECK}" if time is None else _text(time, seen)
    lines += [] if seen.reader == "lerobot" else [f"time: {{column: {name}, unit: {unit or CHECK}}}{note}"]
    lines += _rate(seen, rate, robot)
    joints, templates = _joints(list(columns), robot.spec.joint_names, seen)
    lines += joints
    channels, used = _joint_channels(templates, columns, robot)
    gauges = _gauges(columns, {*used, *([time] if time else [])})
    asked = [channel for one in objectives for channel in one.real_channels]
    called = _called_so([one for one in columns if one not in {*used, *gauges, time}], asked, robot)
    scalars = {*gauges, *called}
    named = _as_asked(gauges, [channel for channel in asked if channel not in called.values()])
    lines += ["channels:", *channels, *_called_lines(called, columns, robot, seen)]
    lines += _gauge_lines(gauges, named, {channel.name for channel in asked}, columns, seen)
    lines += _missing(objectives, {line.split(":")[0].strip() for line in lines}, robot)
    if not channels:
        lines.append(f"  # {CHECK}: no joint channel was recognised. joint_torque: {{columns: ..., unit: N*m}}")
    left = [one for one in columns if one not in {*used, *scalars, time}]
    if left:
        lines.append("# not used: " + ", ".join(left[:60]) + (f", … {len(left) - 60} more" if len(left) > 60 else ""))
    asked_for = "vx" if isinstance(robot.task(), FollowVelocity) else "set_point"
    commands = f"[{{seconds: {CHECK}, {asked_for}: {CHECK}}}]"
    lines.append(f"# recording: {{mass_kg: {CHECK}, schedule: {{commands: {commands}}}}}")
    return "\n".join(lines) + "\n"


def _flat(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Every single column; entries of lists by number."""
    flat: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if values.ndim == 1:
            flat[name] = values
        else:
            flat |= {f"{name}[{at}]": values[:, at] for at in range(values.shape[1])}
    return flat


def _words(name: str) -> set[str]:
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return {word.lower() for word in re.findall(r"[A-Za-z]+", parted)}


def _text(name: str, seen: Glance) -> str:
    """A column as YAML: a number where the file has no names."""
    return name if seen.keys.get("header") is False else json.dumps(name)


def _time(seen: Glance, columns: Mapping[str, np.ndarray]) -> tuple[str | None, str | None, float]:
    """The column of stamps, its unit and the rate, Hz; None where nothing tells."""
    dated = [name for name in seen.dates if _words(name) & TIMES] or list(seen.dates)
    rising = [name for name, values in columns.items() if _rises(values)]
    named = [name for name in rising if _words(name) & TIMES]
    anonymous = rising if seen.keys.get("header") is False else []
    for name in (*named, *anonymous[:1]):
        there = columns[name][np.isfinite(columns[name])]
        step = _step(there)
        stated = [unit for unit in TIME_UNITS if unit in _words(name)]
        unit = stated[0] if stated else _unit_of(step, float(np.nanmax(np.abs(columns[name]))))
        return name, unit, 1.0 / (step * TIME_UNITS[unit])
    return (dated[0], "iso", float("nan")) if dated else (None, None, float("nan"))


HOLE = 10.0  # mean steps: from there on it is a hole and no step


def _step(stamps: np.ndarray) -> float:
    """Mean step of rising stamps, in their unit, holes left out. Not their median: some loggers stamp in bursts."""
    steps = np.diff(stamps)
    return float(steps[steps <= HOLE * steps.mean()].mean())


def _rises(values: np.ndarray) -> bool:
    there = values[np.isfinite(values)]
    return len(there) > 2 and bool(np.all(np.diff(there) > 0))


def _unit_of(step: float, largest: float) -> str:
    """The unit in which a step lasts between 0.1 ms and 0.5 s; of two, the one in which stamps count from 1970."""
    likely = [unit for unit, factor in TIME_UNITS.items() if 1e-4 <= step * factor < 0.5]
    dated = [unit for unit in likely if 1e9 < largest * TIME_UNITS[unit] < 4e9]
    return (dated or likely or ["s"])[0]


def _rate(seen: Glance, rate: float, robot: Robot) -> list[str]:
    logged = float(seen.keys.get("rate_hz", rate))
    if not np.isfinite(logged):
        return [f"rate_hz: {CHECK}  # of the recording, at most that of the log"]
    own = robot.spec.control_rate_hz
    wanted = own if logged > 0.95 * own else float(f"{logged:.3g}")
    return [f"rate_hz: {wanted:g}  # the log has about {logged:.4g} Hz"]


def _joints(names: Sequence[str], joints: Sequence[str], seen: Glance) -> tuple[list[str], dict[str, dict[str, str]]]:
    """Lines of YAML, and template with {joint} -> joint -> column."""
    plain = (lambda one: one, _short, lambda one: _short(one).lower(), lambda one: one.lower())
    for between, alias in ((between, alias) for between in ("_", *BETWEEN) for alias in plain):
        aliases = {joint: alias(joint).replace("_", between) for joint in joints}
        templates = _templates(names, aliases)
        if templates:
            listed = ", ".join(f"{joint}: {json.dumps(one)}" for joint, one in aliases.items())
            return [f"joints: {{{listed}}}"], templates
    count = len(joints)
    if seen.keys.get("header") is False:
        return [f"# {CHECK}: joint_order: [...], the robot's joints in the order of the log"], {}
    aliases = {joint: str(at) for at, joint in enumerate(joints)}
    templates = {
        template: columns
        for template, columns in _templates(names, aliases, numbers=True).items()
        if template.replace("{joint}", str(count)) not in names or "[" in template
    }
    if not templates:
        return [], {}
    listed = ", ".join(f"{joint}: {json.dumps(one)}" for joint, one in aliases.items())
    return [f"joints: {{{listed}}}  # {CHECK}: numbered in the log, the robot's order is assumed"], templates


def _short(joint: str) -> str:
    return re.sub(r"_?joint$", "", joint)


def _templates(names: Sequence[str], aliases: Mapping[str, str], numbers: bool = False) -> dict[str, dict[str, str]]:
    """Names in which each joint's alias stands in turn, with {joint} in its place."""
    first = next(iter(aliases.values()))
    edge = r"(?<!\d){}(?!\d)" if numbers else r"(?<![A-Za-z0-9]){}(?![A-Za-z0-9])"
    found = {}
    for name in names:
        for match in re.finditer(edge.format(re.escape(first)), name):
            template = f"{name[: match.start()]}{{joint}}{name[match.end() :]}"
            columns = {joint: template.replace("{joint}", one) for joint, one in aliases.items()}
            if len(set(columns.values())) == len(aliases) and all(one in names for one in columns.values()):
                found[template] = columns
    return found


def _joint_channels(
    templates: Mapping[str, Mapping[str, str]], columns: Mapping[str, np.ndarray], robot: Robot
) -> tuple[list[str], set[str]]:
    lines: list[str] = []
    used: set[str] = set()
    taken: set[str] = set()
    wanted_first = sorted(templates, key=lambda one: (bool(_words(one) & QUANTITIES["joint_target"][1]), len(one)))
    for template in wanted_first:
        by_joint, words = templates[template], _words(template.replace("{joint}", " "))
        for channel, (unit, known) in QUANTITIES.items():
            if not words & known or channel in taken:
                continue
            if channel == "joint_target" and words & (QUANTITIES["joint_velocity"][1] | QUANTITIES["joint_torque"][1]):
                continue
            wanted = robot.channels().get(channel)
            values = np.stack([columns[one] for one in by_joint.values()], axis=1)
            unit, why = _joint_unit(unit, template, values, robot)
            about = "" if wanted is not None else ", real: false"
            lines.append(f"  {channel}: {{columns: {json.dumps(template)}, unit: {unit}{about}}}{why}")
            taken.add(channel)
            used |= set(by_joint.values())
            break
    return lines, used


def _joint_unit(unit: str, template: str, values: np.ndarray, robot: Robot) -> tuple[str, str]:
    """The unit, and a remark where values or words contradict the usual one."""
    for word in _whole(template.replace("{joint}", " ")):
        usual, said = OTHER_UNITS.get(word, ("", ""))
        if usual == unit:
            return said, ""
    limits = {"rad/s": robot.spec.velocity_limit, "N*m": robot.spec.torque_limit}.get(unit)
    reach = np.asarray(limits) if limits else np.abs(np.asarray(robot.spec.position_limit)).max(axis=1) + 0.35
    typical = np.nanmedian(np.abs(values), axis=0) if np.isfinite(values).any() else np.zeros(len(reach))
    degrees = bool(_words(template.replace("{joint}", " ")) & DEGREES)
    if degrees and unit.startswith("rad"):
        return unit.replace("rad", "deg"), ""
    if np.any(typical > reach):
        return unit, f"  # {CHECK}: typical values lie beyond the robot's limits; other unit, or not what it is called"
    return unit, ""


def _whole(name: str) -> set[str]:
    """Its words: mA is one, though in `_words` its capital begins another."""
    return set(re.findall(r"[a-z]+", name.lower()))


def _gauge_unit(name: str, words: set[str]) -> str | None:
    """The unit that a column's name tells; None where it is no gauge's."""
    unit = next((one for short, one in MILLI.items() if short in _whole(name)), None)
    unit = unit or next((one for one, known in GAUGES.items() if words & known), None)
    symbol = SYMBOL.match(name)
    return unit or (SYMBOLS[symbol[1]] if symbol else None)


def _gauges(columns: Mapping[str, np.ndarray], used: set[str]) -> dict[str, str]:
    """Single columns that by their name are a current, a voltage or the like, and its unit: real channels, whose idle
    level only the person at the robot knows."""
    found: dict[str, str] = {}
    for name, values in columns.items():
        words = _words(name)
        if name in used or words & NOT_MEANS or re.search(r"\d\]?$", name) or not np.isfinite(values).any():
            continue
        unit = _gauge_unit(name, words)
        if unit is not None:
            found[name] = unit
    return found


def _as_asked(gauges: Mapping[str, str], asked: Iterable[Channel]) -> dict[str, str]:
    """Column -> the channel that is asked for, where neither has another that its unit would fit."""
    wanted = {channel.name: channel.unit for channel in asked}
    fits = {
        column: [name for name, unit in wanted.items() if one_quantity(own, unit)] for column, own in gauges.items()
    }
    rivals = Counter(name for names in fits.values() for name in names)
    return {column: names[0] for column, names in fits.items() if len(names) == 1 and rivals[names[0]] == 1}


def _called_so(names: Sequence[str], asked: Iterable[Channel], robot: Robot) -> dict[str, Channel]:
    """Column -> the single channel, of the robot or asked for, whose very name it has, capitals and dots apart."""
    wanted = {channel.name: channel for channel in (*asked, *robot.channels().values()) if channel.shape == ()}
    plain = {name: re.sub(r"\W+", "_", name).strip("_").lower() for name in names}
    often = Counter(plain.values())
    return {name: wanted[one] for name, one in plain.items() if one in wanted and often[one] == 1}


def _called_lines(
    called: Mapping[str, Channel], columns: Mapping[str, np.ndarray], robot: Robot, seen: Glance
) -> list[str]:
    lines = []
    for name, channel in called.items():
        what = f"{_text(name, seen)}, unit: {json.dumps(channel.unit)}"
        about = "whether the column is in that unit: its name is all that was looked at"
        if channel.name not in robot.channels():
            what += ", resample: hold" if np.isfinite(columns[name]).mean() < SELDOM else ""
            what, about = f"{what}, idle: {CHECK}", f"idle level, and {about}"
        lines.append(f"  {channel.name}: {{columns: {what}}}  # {CHECK}: {about}")
    return lines


def _gauge_lines(
    gauges: Mapping[str, str],
    named: Mapping[str, str],
    asked: Collection[str],
    columns: Mapping[str, np.ndarray],
    seen: Glance,
) -> list[str]:
    """named: column -> its channel, where an objective tells; asked: names of channels that one asks for."""
    lines: list[str] = []
    for number, (name, unit) in enumerate(gauges.items()):
        values = columns[name]
        channel = re.sub(r"\W+", "_", name).strip("_").lower()
        channel = channel if channel.isidentifier() and channel != "time" else f"gauge_{number}"
        sign = ", sign: -1" if np.nanmedian(values) < 0 and unit.endswith(("A", "W")) else ""
        why = "sign: its values are negative; " if sign else ""
        slow = ", resample: hold" if np.isfinite(values).mean() < SELDOM else ""
        what = f"{_text(name, seen)}, unit: {unit}{sign}{slow}, idle: {CHECK}"
        about = "idle level, unit, and the channel's name, which an objective asks for"
        if channel in asked and named.get(name, channel) == channel:
            about = "idle level and unit"
        elif name in named:
            about = f"idle level, unit, and whether it is {named[name]}, by its unit alone"
        lines.append(f"  {named.get(name, channel)}: {{columns: {what}}}  # {CHECK}: {why}{about}")
    return lines


def _missing(objectives: Iterable[Objective], there: set[str], robot: Robot) -> list[str]:
    """Comments: what objectives read or measure and no line gives. there: keys of the lines."""
    lines: dict[str, str] = {}
    own = robot.channels()
    for objective in objectives:
        units = {name: own[name].unit if name in own else CHECK for name in objective.inputs}
        units |= {channel.name: channel.unit for channel in objective.real_channels}
        for name in units.keys() - there - lines.keys():
            idle = "" if name in own else f", idle: {CHECK}"
            lines[name] = (
                f"  # {CHECK}: objective '{objective.name}' needs it, no column was recognised. "
                f"{name}: {{columns: ..., unit: {units[name]}{idle}}}"
            )
    return [lines[name] for name in sorted(lines)]
