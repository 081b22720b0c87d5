"""What the gate in simulation said of a bundle's policies: one that failed is walked only if a person vouches for it.

Whoever vouches is beside the robot now. Nothing keeps it: a hash says which policy, and not who typed it, whether the
same person stands there at the next visit, and on which floor. So each command asks anew.

A policy's `gate` in the manifest is null (nobody tried it, as with the policy that data are collected with), or what
`hts` found: `passed`, and if not, `failed` (the checks) and `refused` (a line that says how).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.policy import Policy

LEAST_DIGITS = 12  # of a policy's hash, by which it is vouched for


def check_gate(gate: object, where: str) -> None:
    """Raise RuntimeFault for a result that does not say whether the gate was passed."""
    if gate is not None and not (isinstance(gate, Mapping) and isinstance(gate.get("passed"), bool)):
        raise RuntimeFault(
            f"{where}: gate {str(gate)[:60]}, expected null, or `passed` true or false. Make the bundle again."
        )


def check_whose(gate: Mapping[str, Any] | None, card: Mapping[str, Any], where: str) -> None:
    """Raise RuntimeFault for a result that is another policy's. card: which the graph carries; commands of held speeds
    in front of a policy have a hash of their own, and what was found of the policy inside holds for both."""
    if gate is None:
        return
    made = card.get("made")
    held = made.get("held") if isinstance(made, Mapping) else None
    hashes = [card.get("policy_hash"), held.get("policy_hash") if isinstance(held, Mapping) else None]
    found = gate.get("policy_hash")
    if found is None and not gate["passed"]:
        return  # a refusal need not say whom: nothing is gained by believing it
    if found is None or found not in hashes:
        whose = "does not say of which policy it is" if found is None else f"is of policy {str(found)[:LEAST_DIGITS]}…"
        raise RuntimeFault(
            f"{where}: its gate result {whose}, the graph is {str(hashes[0])[:LEAST_DIGITS]}…. Make the bundle again."
        )


def gate_in_words(gate: Mapping[str, Any] | None) -> str:
    """A few words for a list."""
    if gate is None:
        return "gate not tried"
    return "passed the gate" if gate["passed"] else f"FAILED the gate: {_checks(gate)}"


def why_failed(gate: Mapping[str, Any] | None) -> str:
    """How a policy failed the gate, in a line; "" if it did not, or was not tried."""
    if gate is None or gate["passed"]:
        return ""
    return " ".join(str(gate.get("refused") or _checks(gate)).split())[:300]


def vouched_for(files: Iterable[str], policies: Mapping[str, Policy], vouched: Sequence[str]) -> dict[str, str]:
    """file -> how it failed the gate, of those policies among `files` that did and for which a person vouches.

    vouched: beginnings of policy hashes, LEAST_DIGITS or more. Raises RuntimeFault for a policy that failed and for
    which nobody vouches, and for a beginning that is of no policy that failed.
    """
    failed = {file: why for file, policy in policies.items() if (why := why_failed(policy.entry["gate"]))}
    hashes = {file: str(policies[file].entry["policy_hash"]) for file in failed}
    for digits in vouched:
        if len(digits) < LEAST_DIGITS or not any(one.startswith(digits) for one in hashes.values()):
            short = ", ".join(dict.fromkeys(one[:LEAST_DIGITS] for one in hashes.values()))
            raise RuntimeFault(
                f"--vouch '{digits}': expected {LEAST_DIGITS} digits or more of the hash of a policy that failed the "
                f"gate; here these failed: {short or 'none'}."
            )
    asked = {file: failed[file] for file in dict.fromkeys(files) if file in failed}
    nobody = [file for file in asked if not hashes[file].startswith(tuple(vouched))]
    if nobody:
        options = " ".join(dict.fromkeys(f"--vouch {hashes[file][:LEAST_DIGITS]}" for file in nobody))
        raise RuntimeFault(
            f"{', '.join(nobody)} failed the gate in simulation ({failed[nobody[0]]}). Record other rows (--rows), or, "
            f"if you have looked at that and put your name to it: {options}. Each command and each bundle asks anew, "
            "also where somebody vouched before: it is for whoever is beside the robot now to say."
        )
    return asked


def _checks(gate: Mapping[str, Any]) -> str:
    checks = gate.get("failed")
    if not isinstance(checks, list) or not checks:
        return "it does not say how"
    return " ".join(", ".join(str(one) for one in checks).split())[:120]
