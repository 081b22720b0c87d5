"""Who is refused in a trial may have fallen in it too: the summary and the report say both."""

from __future__ import annotations

from hts.recordings.recording import Series
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

TWO_TRIED = {"sweep.kl_bounds": [1.0, 2.0], "selection.elites": 2, "finetune.steps": 96}


def lies_down(recording):
    walked = recording.channels["base_velocity"]
    still = Series(walked.channel, 0.0 * walked.values)
    return recording.replace(channels={**recording.channels, "base_velocity": still}, fell=True)


def test_falls_of_who_is_refused_reach_the_summary(tmp_path, monkeypatch):
    plain, tried = KnownWorld._head_to_head, []

    def head_to_head(self, policy, *rest):
        tried.append(policy.stem)
        found = plain(self, policy, *rest)
        falls = policy.stem == tried[0]
        return [lies_down(one) if one.role == "policy" and falls else one for one in found]

    monkeypatch.setattr(KnownWorld, "_head_to_head", head_to_head)
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings=TWO_TRIED)
    (iteration,) = run.summary["iterations"]
    rows = {row["id"]: row for row in iteration["candidates"] if row["elite"]}
    fallen = next(row for name, row in rows.items() if name in tried[0])
    other = next(row for name, row in rows.items() if name not in tried[0])
    assert "segments of the policy are valid" in fallen["refused"] and "with 2 falls" in fallen["refused"]
    assert fallen["refused_falls"] == {"0.8": 2}  # one in each of its two blocks
    assert other["real"] and "refused_falls" not in other
    assert run.summary["final"]["policy"] == other["id"]
