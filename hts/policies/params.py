"""What mjlab and Isaac Lab write beside a checkpoint: `params/env.yaml`, `params/agent.yaml`, and an exported ONNX.

They are written by `yaml.dump` with Python's own tags. Here a tag names nothing and runs nothing: a tuple is a list, a
function its name, an object its fields.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from hts.errors import PolicyError
from hts.policies.contract import Contract
from hts.policies.onnx_metadata import read_metadata
from hts.policies.source import OWN_NAMES, Source
from hts.policies.terms import ABSOLUTE, NOT_MEASURED, OURS, our_name

LARGEST_FILE = 4 * 2**20  # bytes; mjlab's env.yaml has 40 kB


def source_beside(path: Path, params: Path | None = None) -> Source:
    """What the files beside a checkpoint say, all of it optional. params: their folder, if not `params/` beside it.

    Raises PolicyError for a file that is broken, or says what cannot be followed (an observation with history).
    """
    folder = params or path.parent / "params"
    if params is not None and not (params / "env.yaml").is_file():
        raise PolicyError(f"{params}: has no env.yaml. Give the folder that mjlab or Isaac Lab calls `params`.")
    found = Source()
    said = {name: _load(folder / name) for name in ("env.yaml", "agent.yaml") if (folder / name).is_file()}
    seen = _groups(said.get("agent.yaml", {}))
    for name, values in said.items():
        file = folder / name
        try:
            found = found.over(_of_env(file, values, seen) if name == "env.yaml" else _of_agent(file, values))
        except (AttributeError, TypeError, ValueError, KeyError) as error:
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            raise PolicyError(
                f"{file}: not as mjlab or Isaac Lab writes it ({what[:120]}). Move it away and state its contract "
                "in a layout."
            ) from error
    if found.contract.joint_names is None:
        found = found.over(_exported_beside(path))
    return found


def _exported_beside(path: Path) -> Source:
    """Joint names of the ONNX file that mjlab exports into the folder of its checkpoints, under the folder's name."""
    exported = path.parent / f"{path.parent.resolve().name}.onnx"
    if not exported.is_file() or exported == path:
        return Source()
    contract = read_metadata(exported).contract
    # its other numbers are rounded to three decimals
    said = {"joint_names": contract.said_by.get("joint_names", exported.name)}
    return Source(Contract(joint_names=contract.joint_names, said_by=said if contract.joint_names else {}))


class _PlainLoader(yaml.SafeLoader):
    """Reads Python's tags as what they hold."""


def _plain(loader: _PlainLoader, suffix: str, node: yaml.Node) -> Any:
    if isinstance(node, yaml.ScalarNode):
        return suffix.split(":", 1)[1] if suffix.startswith("name:") else loader.construct_scalar(node)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_PlainLoader.add_multi_constructor("tag:yaml.org,2002:python/", _plain)


def _load(file: Path) -> Mapping[str, Any]:
    if file.stat().st_size > LARGEST_FILE:
        raise PolicyError(f"{file}: has more than {LARGEST_FILE >> 20} MB, which no such file has.")
    try:
        found = yaml.load(file.read_text(encoding="utf-8"), _PlainLoader)
    except (yaml.YAMLError, OSError, ValueError, RecursionError) as error:
        what = "nested too deep" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise PolicyError(f"{file}: cannot be read ({what[:160]}).") from error
    if not isinstance(found, Mapping):
        raise PolicyError(f"{file}: expected keys and values, found a {type(found).__name__}.")
    return found


# ------------------------------------------------------------------------------------------------ env.yaml


def _of_env(file: Path, env: Mapping[str, Any], seen: Sequence[str]) -> Source:
    """seen: the groups of observations that the actor is given, one behind the other; none: the one called so."""
    said: dict[str, Any] = {}
    scene, sim = env["scene"], env["sim"]
    entities = scene.get("entities") or {}
    robot = entities.get("robot") or scene.get("robot") or {}
    physics_dt = sim.get("dt") or (sim.get("mujoco") or {}).get("timestep")
    if physics_dt and env.get("decimation"):
        said["control_rate_hz"] = 1.0 / (float(physics_dt) * int(env["decimation"]))
    pose = (robot.get("init_state") or {}).get("joint_pos")
    if pose:
        said["default_pose"] = dict(pose)
    actuators = robot.get("actuators") or (robot.get("articulation") or {}).get("actuators") or ()
    groups = list(actuators.values()) if isinstance(actuators, Mapping) else list(actuators)
    gains, lags = _gains(groups)
    said |= gains
    if lags is not None and physics_dt:
        said["delay_seconds"] = (lags[0] * float(physics_dt), lags[1] * float(physics_dt))
    actions = env.get("actions") or {}
    said |= _action(file, actions)
    observations = env.get("observations") or {}
    seen = seen or [name for name in ("actor", "policy") if name in observations][:1]
    known = all(isinstance(observations.get(name), Mapping) for name in seen)
    groups = [_terms_of(observations[name]) for name in seen] if known else []
    order = _joint_order(file, next(iter(actions.values())), groups)
    if order:
        said["joint_names"] = order
    contract = Contract(**said, said_by=dict.fromkeys(said, f"{file.parent.name}/{file.name}"))
    parts = [
        part for name, terms in zip(seen, groups, strict=False) for part in _terms(file, observations[name], terms)
    ]
    return Source(contract, tuple(parts))


def _joint_order(
    file: Path, action: Mapping[str, Any], groups: Sequence[Mapping[str, Mapping[str, Any]]]
) -> tuple[str, ...]:
    """The joints in the order that all terms ask for by name (`preserve_order`); empty where the simulator's stands.

    Raises PolicyError for actions and observations in different orders.
    """
    orders = {"its action": _preserved(action)}
    for name, term in ((name, term) for terms in groups for name, term in terms.items()):
        if str(term.get("func") or "").replace(":", ".").rsplit(".", 1)[-1] in OF_JOINTS:
            orders[f"its observation '{name}'"] = _preserved((term.get("params") or {}).get("asset_cfg") or {})
    (first, order), *others = orders.items()
    for name, other in others:
        if other != order:
            told = [", ".join(one)[:80] + " (preserve_order)" if one else "the simulator's" for one in (order, other)]
            raise PolicyError(
                f"{file}: {first} has the joints in the order {told[0]}, {name} in {told[1]}. hts reads one order of "
                "joints for both. Train it with one: the same joint_names and preserve_order in all of them."
            )
    return order if all(re.fullmatch(r"[\w-]+", name) for name in order) else ()


def _preserved(chosen: Mapping[str, Any]) -> tuple[str, ...]:
    """The names or patterns whose order a term keeps; empty where it takes the simulator's."""
    names = chosen.get("joint_names") or chosen.get("actuator_names") or ()
    names = (names,) if isinstance(names, str) else tuple(str(name) for name in names)
    return names if chosen.get("preserve_order") and names != (".*",) else ()


def _gains(groups: list[Mapping[str, Any]]) -> tuple[dict[str, Any], tuple[int, int] | None]:
    """kp and kd by patterns of joint names, and least and most delay in physics steps."""
    kp: dict[str, float] = {}
    kd: dict[str, float] = {}
    least, most = [], []
    for group in groups:
        inner = group.get("base_cfg") or group
        patterns = inner.get("target_names_expr") or inner.get("joint_names_expr") or ()
        for key, into in (("stiffness", kp), ("damping", kd)):
            value = inner.get(key)
            if isinstance(value, Mapping):
                into.update(value)
            elif value is not None:
                into.update(dict.fromkeys(patterns, value))
        least.append(int(group.get("delay_min_lag", group.get("min_delay")) or 0))
        most.append(int(group.get("delay_max_lag", group.get("max_delay")) or 0))
    found = {key: value for key, value in (("kp", kp), ("kd", kd)) if value}
    return found, (min(least), max(most)) if groups else None


def _action(file: Path, actions: Mapping[str, Any]) -> dict[str, Any]:
    """Scale, clip and offset of the only action term, a joint position."""
    if len(actions) != 1:
        raise PolicyError(
            f"{file}: has {len(actions)} actions ({', '.join(map(str, actions))[:80]}), expected one, of joint "
            "positions."
        )
    name, term = next(iter(actions.items()))
    kind = str(term.get("class_type") or "").rsplit(":", 1)[-1]
    if kind and kind != "JointPositionAction":
        raise PolicyError(f"{file}: its action '{name}' is a {kind[:60]}, expected a JointPositionAction.")
    if not term.get("use_default_offset"):
        raise PolicyError(
            f"{file}: its action '{name}' is not counted from the default pose (use_default_offset). State "
            "default_pose in a layout as the targets where its actions are zero, and move this file away."
        )
    if term.get("clip"):
        raise PolicyError(f"{file}: its action '{name}' clips targets, which hts does not. Train it without clip.")
    scale = term["scale"]
    return {"action_scale": dict(scale) if isinstance(scale, Mapping) else scale}


def _terms_of(group: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
    terms = group.get("terms") or {
        key: value for key, value in group.items() if isinstance(value, Mapping) and "func" in value
    }
    return {str(name): term for name, term in terms.items() if term is not None}


def _terms(
    file: Path, group: Mapping[str, Any], terms: Mapping[str, Mapping[str, Any]]
) -> tuple[Mapping[str, Any], ...]:
    if group.get("history_length"):
        raise PolicyError(f"{file}: its policy sees {group['history_length']} observations at once, hts shows one.")
    parts: list[dict[str, Any]] = []
    for name, term in terms.items():
        if term.get("modifiers"):
            raise PolicyError(
                f"{file}: its observation '{name}' goes through modifiers, which hts does not compute. Train it "
                "without; a scale alone can be the term's `scale`."
            )
        if term.get("history_length") or term.get("delay_max_lag"):
            which = "history" if term.get("history_length") else "a delay"
            raise PolicyError(f"{file}: its observation '{name}' has {which}, which hts does not show a policy.")
        clip = term.get("clip")
        if clip and max(abs(float(clip[0])), abs(float(clip[1]))) < HARMLESS_TERM_CLIP:
            raise PolicyError(f"{file}: its observation '{name}' is clipped at {clip}, which hts does not do.")
        scale = term.get("scale")
        if isinstance(scale, list | tuple):
            scale = [float(one) for one in scale]
        elif scale is not None:
            scale = float(scale)
        parts.append({"name": _meaning(str(name), term), "scale": 1.0 if scale is None else scale})
    return tuple(parts)


OF_JOINTS = {"joint_pos", "joint_pos_rel", "joint_vel", "joint_vel_rel"}
"""Functions of both libraries that observe joints, in the order that the term's asset_cfg asks for."""
HARMLESS_TERM_CLIP = 50.0  # in any unit of ours: nothing that a robot measures goes there


def _meaning(name: str, term: Mapping[str, Any]) -> str:
    """Our name of a term: by its function or the sensor that this reads, by its own name only where there is none."""
    function = str(term.get("func") or "").replace(":", ".").rsplit(".", 1)[-1]
    sensor = str((term.get("params") or {}).get("sensor_name") or "").rsplit("/", 1)[-1]
    if function == "joint_pos":  # in both libraries the angles themselves, whatever the term is called
        return ABSOLUTE
    asked = (sensor,) if function in ("builtin_sensor", "") and sensor else (function or name,)
    for known in asked:
        if known in OURS or known in NOT_MEASURED or known in OWN_NAMES:
            return our_name(known)
    return asked[0]


# ---------------------------------------------------------------------------------------------- agent.yaml


def _groups(agent: Mapping[str, Any]) -> list[str]:
    """The groups of observations that rsl_rl gives the actor, in order; empty where the file does not say."""
    sets = agent.get("obs_groups")
    found = (sets.get("actor") or sets.get("policy")) if isinstance(sets, Mapping) else None
    return [str(name) for name in found] if isinstance(found, list | tuple) else []


def _of_agent(file: Path, agent: Mapping[str, Any]) -> Source:
    model = agent.get("actor") or agent.get("policy") or {}
    said: dict[str, Any] = {}
    if agent.get("clip_actions") is not None:
        said["action_clip"] = float(agent["clip_actions"])
    kind = str(model.get("class_name") or "")
    if "Recurrent" in kind or "RNN" in kind or "CNN" in kind:
        raise PolicyError(f"{file}: its policy is a {kind[:60]}; only plain networks can be read.")
    contract = Contract(**said, said_by=dict.fromkeys(said, f"{file.parent.name}/{file.name}"))
    return Source(contract, (), str(model.get("activation") or ""))
