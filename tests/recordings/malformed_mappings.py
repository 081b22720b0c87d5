"""Mappings that are not what they should be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import yaml
from malformed_case import BAD, Case


def mappings(name: str, *changes: Callable[[dict[str, Any]], Any]) -> None:
    """A kind that changes the mapping in one of several ways."""

    def spoil(made: Case) -> None:
        made.write()
        made.chance.choice(changes)(made.given)

    BAD[name] = spoil


def channel(name: str, **what: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda given: given["channels"][name].update(what)


mappings("misspelt_key", lambda g: g.update(rate_htz=50), lambda g: g.pop("time"), channel("draw", unti="A"))
mappings("unit_nobody_knows", *(channel("draw", unit=one) for one in ("Nm", "ampère?", "9**9**9", "", "A" * 100)))
mappings("unit_of_another_quantity", channel("joint_torque", unit="A"), channel("joint_torque", unit="rad/s"))
mappings("joint_nobody_has", lambda g: g["joints"].update(ankle="A"), lambda g: g["joints"].pop("hip"))
mappings(
    "one_column_for_two",
    lambda g: g["joints"].update(knee="H"),
    channel("joint_torque", columns=["H_tau", "H_tau"]),
    channel("draw", columns=["amps", "amps"], sum=True),
)
mappings("no_idle_level", lambda g: g["channels"]["draw"].pop("idle"), channel("draw", idle="CHECK"))
mappings("no_channel", lambda g: g.update(channels={}), lambda g: g.pop("channels"), lambda g: g.update(channels=3))
mappings(
    "rate_that_is_none", *(lambda g, r=r: g.update(rate_hz=r) for r in (0, -5, float("nan"), float("inf"), "fast"))
)
mappings("rate_beyond_the_log", *(lambda g, r=r: g.update(rate_hz=r) for r in (1e3, 1e9, 1e300)))
mappings("numbers_that_are_none", channel("draw", scale=float("nan")), channel("draw", offset=float("inf")))
mappings("limits_turned_round", channel("draw", limits=[9, 1]), channel("draw", limits=[1]))
mappings("limits_that_do_not_hold", channel("draw", limits=[0, 1]), channel("joint_torque", limits=[-1e-3, 1e-3]))
mappings("cut_beside_the_log", lambda g: g.update(cut=[50, 90]), lambda g: g.update(cut=[2, 1]))
mappings("range_that_is_none", *(channel("draw", columns=one) for one in ("0..999999", "5..1", "q[1..", "..")))
mappings("reader_nobody_knows", lambda g: g.update(reader="csvv"), lambda g: g.update(reader="../../etc"))
mappings("runs_of_nothing", lambda g: g.update(runs={"column": "run"}), lambda g: g.update(runs={"gap_seconds": -1}))
mappings("labels_without_a_file", lambda g: g.update(labels={"file": "labels"}))
mappings(
    "gains_for_other_joints", lambda g: g.update(recording={"kp": [1.0]}), lambda g: g.update(recording={"kd": [1] * 9})
)
mappings(
    "facts_that_are_none", lambda g: g.update(recording={"mass_kg": -1}), lambda g: g.update(recording={"role": "x"})
)


def texts(name: str, make: Callable[[Case], str | bytes]) -> None:
    """A kind whose mapping is such a text."""

    def spoil(made: Case) -> None:
        made.write()
        made.text = make(made)

    BAD[name] = spoil


def bomb(made: Case) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, made.chance.randrange(9, 30))]
    return "\n".join(lines)


texts("key_twice", lambda made: yaml.safe_dump(made.given) + "rate_hz: 51\n")
texts("bottomless_nesting", lambda made: "a: " + made.chance.choice("[{") * made.chance.randrange(1000, 20_000))
texts("aliases_that_explode", bomb)
texts("alias_of_itself", lambda made: "a: &a [*a]\n")
texts("code_in_a_mapping", lambda made: f"a: !!python/object/apply:os.system ['touch {made.folder}/ran']\n")
texts("no_yaml", lambda made: made.chance.choice(["a: [", "{", "a: b: c", "\t- a", "'", "!!binary x: y", "%YAML 9.9"]))
texts("no_mapping_at_all", lambda made: made.chance.choice(["", "- 1", "3", "null", "text", "--- \n---\n"]))
texts("mapping_of_bytes", lambda made: b"\xff\xfe" + made.chance.randbytes(200))
