"""What came of a run with a script as operator, as one JSON object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from field import stages
from field.books import Books


def outcome(run: Path, books: Books, wanted: tuple[str, ...]) -> dict[str, Any]:
    """Of a run that is finished or not."""
    visits, bundles, kills = books.entries("visits"), books.entries("bundles"), books.entries("kills")
    walked, sat = sum(one["simulated_s"] for one in visits), sum(one["wall_s"] for one in visits)
    elapsed = sum(one["wall_s"] for one in bundles)
    heard = [one["states"] for one in visits if one["states"]]
    now, killed = stages.stamps(run), {one["what"] for one in kills}
    again = {name for one in kills for name, stamp in one["finished"].items() if now.get(name) != stamp}
    return {
        **_of_the_run(run),
        "wall_s": books.wall_seconds,
        "stage_s": stages.seconds(run),
        "hts_starts": len(books.entries("starts")),
        "visits": {
            "bundles": len(bundles),
            "number": len(visits),
            "simulated_s": round(walked, 1),
            "wall_s_of_bundles": round(elapsed, 1),
            "simulated_s_per_wall_s_of_a_robot": round(walked / sat, 2) if sat else None,
            "simulated_s_per_wall_s_of_all": round(walked / elapsed, 2) if elapsed else None,
            "ended_by_a_stop": [{"stage": one["stage"], "why": one["stopped"]} for one in visits if one["stopped"]],
            "falls": sum(one["falls"] for one in visits),
        },
        "packets": {
            "states_received": sum(one["received"] for one in heard),
            "states_lost": sum(one["lost"] for one in heard),
            "states_late": sum(one["late"] for one in heard),
            "line_lost_both_ways": sum(one["line"]["lost"] for one in visits),
            "line_late_both_ways": sum(one["line"]["late"] for one in visits),
        },
        "timing": _timing(visits),
        "kills": [{key: value for key, value in one.items() if key != "finished"} for one in kills],
        "not_killed": [one for one in wanted if one not in killed],
        "stages_done_again": sorted(again),
        "imports": books.entries("imports"),
    }


def _timing(visits: list[dict[str, Any]]) -> dict[str, Any]:
    """The worst of all visits; in real time a step that left a whole period late is a missed deadline."""
    timed = [one for one in visits if "missed_deadlines" in one]
    found: dict[str, Any] = {"steps": sum(one["steps"] for one in timed)}
    for key in ("step_ms_mean", "step_ms_p999", "step_ms_worst", "late_ms_p999", "late_ms_worst", "memory_mb"):
        found[key] = max((one[key] for one in timed), default=None)
    return {**found, "missed_deadlines": sum(one["missed_deadlines"] for one in timed)}


def _of_the_run(run: Path) -> dict[str, Any]:
    """What the run itself says."""
    path = run / "summary.json"
    if not path.exists():
        return {"finished": False, "waits_in": stages.current(run)}
    summary = json.loads(path.read_text())
    final = summary["final"]
    keys = ("preset", "engine", "seed", "real_samples", "sim_steps", "iterations_asked", "world_simulated")
    return {
        "finished": True,
        **{key: summary[key] for key in keys},
        "iterations_done": len(summary["iterations"]),
        "best": final["policy"],
        "saving": {name: _speeds(entry) for name, entry in final["objectives"].items()},
        "saving_open_loop": {
            name: _speeds(entry["open_loop"]) for name, entry in final["objectives"].items() if "open_loop" in entry
        },
        "kept_out_by_the_gate": [len(one.get("gate", {}).get("kept_out", ())) for one in summary["iterations"]],
    }


def _speeds(entry: dict[str, Any]) -> dict[str, Any]:
    """Saving and interval at each speed."""
    keys = ("improvement", "improvement_ci95")
    found: dict[str, Any] = {speed: {key: one.get(key) for key in keys} for speed, one in entry["speeds"].items()}
    if entry.get("refused"):
        found["refused"] = entry["refused"]
    return found
