"""`NAME.gate.json` beside a policy: what the gate before hardware found of it, known by the policy's hash.

A verdict goes with the policy, not with the file's name: an export, a copy or a renamed file of a policy that a run's
gate refused is still that policy. So the notes of the whole run are looked at, and one whose hash is another policy's
is not believed.

`passed` is true, false, or null: no gate that is known tried it, and `untried` says why. A run writes none of these,
`hts export` does, so that an exported file never comes without a word.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hts.errors import PolicyError

Note = Mapping[str, Any]
STOPPED = ["training stopped"]  # what a candidate failed at whose training went wrong


def place(policy: Path) -> Path:
    """Where the note of a policy's file lies."""
    return policy.with_suffix(".gate.json")


def hashes_of(card: Mapping[str, Any]) -> tuple[str, ...]:
    """The policy's own hash, and that of the policy inside where commands of held speeds stand in front of it: what the
    gate found of one holds for the other."""
    made = card.get("made")
    held = made.get("held") if isinstance(made, Mapping) else None
    inside = held.get("policy_hash") if isinstance(held, Mapping) else None
    return (str(card["policy_hash"]), *([str(inside)] if inside else []))


def note_of(source: Path, card: Mapping[str, Any], run: Path | None = None) -> Note | None:
    """What the gate found of a policy: the note beside its file, or one of the same hash in the run's folder; None
    where nobody tried it, also where a note says so. Of several, one that says that it failed; but that a training was
    stopped is said of the candidate: its policy is the anchor's again, which may have passed.

    card: the policy's. Raises PolicyError for a note beside it that is another policy's, and for one that cannot be
    read, since nobody knows whom it refuses.
    """
    hashes, beside = hashes_of(card), _read(place(source))
    if beside is not None:
        _check_whose(place(source), beside, source, hashes)
    found = [] if beside is None else [beside]
    elsewhere = [(path, note) for path in notes(run) if (note := _read(path)) is not None]
    found += [note for path, note in elsewhere if _hash_in(path, note) in hashes and note.get("failed") != STOPPED]
    found = [note for note in found if note["passed"] is not None]
    return next((note for note in found if note.get("passed") is not True), found[0] if found else None)


def lost(source: Path, card: Mapping[str, Any], run: Path | None) -> Note | None:
    """What stands for the note of a policy that another run fine-tuned, and that came without it: nobody here knows
    whether that run's gate refused it, so it counts as refused. None for any other policy: one that nobody fine-tuned,
    or that lies in this run, its policy to start from too: what another run's gate found of that one is not asked."""
    if not _fine_tuned(card) or _is_of(run, hashes_of(card)):
        return None
    why = (
        f"{place(source).name}, which a run and `hts export` write beside a policy that was tried, did not come along, "
        "or it was never tried"
    )
    if (beside := _read(place(source))) is not None:
        why = f"{place(source).name} says that {beside.get('untried')}"
    return {
        "passed": False,
        "failed": ["not known"],
        "policy_hash": str(card["policy_hash"]),
        "refused": f"{source.stem} was fine-tuned in another run, and what the gate found of it there is not known "
        f"here: {why}",
    }


def untried(card: Mapping[str, Any], run: Path | None) -> Note:
    """The note beside an export of a policy of which no gate is known to have found anything. card: the policy's; run:
    the folder that it was exported from, None of a policy file."""
    if _is_of(run, hashes_of(card)):
        why = "its run keeps no finding of a gate about it"
    elif _fine_tuned(card):
        why = "a run fine-tuned it, and what its gate found of it was not known where it was exported"
    else:
        why = "no run fine-tuned it, and no finding of a gate about it is known"
    return {"passed": None, "untried": why, "policy_hash": str(card["policy_hash"])}


def _fine_tuned(card: Mapping[str, Any]) -> bool:
    made = card.get("made")
    return isinstance(made, Mapping) and "anchor" in made


def _is_of(run: Path | None, hashes: Sequence[str]) -> bool:
    """Whether a policy is one of a run's own."""
    if run is None:
        return False
    tensors = [*(run / "policies").glob("*.safetensors"), *(run / "iterations").glob("*/candidates/*.safetensors")]
    return any(_hash_on(path.with_suffix(".json")) in hashes for path in tensors)


def notes(run: Path | None) -> Sequence[Path]:
    """All notes of a run."""
    if run is None:
        return ()
    return sorted((run / "policies").glob("*.gate.json")) + sorted((run / "iterations").glob("*/**/*.gate.json"))


def refusal(note: Note | None, name: str) -> str:
    """Why the gate refused a policy; "" if it did not. name: of the policy, where the note says no more."""
    if note is None or note.get("passed") is not False:
        return ""
    return str(note.get("refused") or f"{name} is refused by the gate")


def warning_beside(policy: Path) -> str:
    """What the note beside a policy's file says against walking it on a machine, one sentence: the gate refused it, or
    nobody is known to have tried it; "" where it passed, or without a note."""
    note = _read(place(policy))
    if refused := refusal(note, policy.name):
        return f"{refused}. It is not bundled for a machine (docs/safety.md)."
    if note is None or note["passed"] is True:
        return ""
    return (
        f"{policy.name}: as far as is known, this policy has not been through the gate ({note['untried']}). "
        f"{place(policy).name} says so too. What the gate checks in simulation: docs/safety.md."
    )


def _check_whose(path: Path, note: Note, source: Path, hashes: Sequence[str]) -> None:
    """A note that refuses need not say whom: nothing is gained by believing it."""
    found = note.get("policy_hash")
    if found in hashes or (found is None and note.get("passed") is False):
        return
    whose = "does not say of which policy it is" if found is None else f"is of policy {str(found)[:12]}…"
    raise PolicyError(
        f"{path}: {whose}, but {source.name} is {hashes[0][:12]}…. Move the file away if it is of another policy; "
        "`hts export RUN` writes the right one beside a policy."
    )


def _hash_in(path: Path, note: Note) -> str | None:
    """Whose note of a run it is. Notes of earlier versions that kept a policy out lack it: the card beside them says
    it."""
    if note.get("policy_hash") is not None:
        return str(note["policy_hash"])
    return _hash_on(path.with_name(path.name.removesuffix(".gate.json") + ".json"))


def _hash_on(card: Path) -> str | None:
    """Of which policy a card is; None where it cannot be read."""
    try:
        found = json.loads(card.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return str(found.get("policy_hash")) if isinstance(found, Mapping) else None


def _read(path: Path) -> Note | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise PolicyError(
            f"{path}: cannot be read as JSON ({' '.join(str(error).split())[:120]}), so nobody knows whether the gate "
            "refused its policy. Restore the file, or take a policy that passed."
        ) from error
    tried = isinstance(found, Mapping) and isinstance(found.get("passed"), bool)
    says_untried = (
        isinstance(found, Mapping) and found.get("passed", "") is None and isinstance(found.get("untried"), str)
    )
    if not (tried or says_untried):
        raise PolicyError(
            f"{path}: found {str(found)[:60]}, expected `passed` true or false, or null with `untried`, why. Restore "
            "the file, or take a policy that passed."
        )
    return dict(found)
