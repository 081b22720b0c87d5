"""Lines of runs that never were: methods with known savings over realities."""

from __future__ import annotations

from batch.lines import Figures, Line, Model, Outcome, Pair, Point, Result, Tried


def line(method="ours", reality="dev-00", seed=0, saved=(0.1, 0.2, 0.3), **changes) -> Line:
    """A run at three speeds. saved: at each, None where it was refused; all None: the pretrained one stayed."""
    speeds = ["0.5", "0.8", "1.1"]
    found = {key: figures(value) for key, value in zip(speeds, saved, strict=True) if value is not None}
    refused = {key: "too slow" for key, value in zip(speeds, saved, strict=True) if value is None}
    outcome = {"power": Outcome(unit="1", held=found, open_loop=found, refused=refused)} if found else {}
    tried = Tried(
        id="00-01",
        iteration=0,
        anchor="pretrained",
        weights={"power": 1.0},
        kl_bound=1.0,
        kl=0.9,
        sim_score=1.0,
        sim_falls=0,
        predicted={"power": {"0.8": 0.25}},
        measured={"power": {"0.8": 0.2}},
    )
    result = Result(
        final_policy="00-01" if found else "pretrained",
        asked_speeds=[0.5, 0.8, 1.1],
        objectives=outcome,
        best=tried if found else None,
        tried=[tried],
        candidates=3,
        models=[
            Model(
                iteration=0,
                objective="power",
                held_out_r2=0.9,
                pairs=[Pair(policy="a", measured=5.0, predicted=5.1), Pair(policy="b", measured=4.0, predicted=4.2)],
            )
        ],
        pooled_rank={"power": 0.8},
        curve=[Point(iteration=0, samples=30_000, best="00-01", improvement={"power": {"0.8": 0.2}})],
        real_samples={"collect": 20_000, "iterations/00/test": 10_000, "final": 20_000, "total": 50_000},
        sim_steps=1,
        seconds={"total": 300.0},
    )
    values = {
        "key": f"{method}-{reality}-{seed}-{changes.get('commit', 'c' * 40)}",
        "status": "done",
        "batch": "test",
        "method": method,
        "method_hash": "m" * 64,
        "reality": reality,
        "reality_hash": reality,
        "seed": seed,
        "preset": "quick",
        "commit": "c" * 40,
        "arguments": ["run", "--objective", "power"],
        "ended": "2026-01-01T00:00:00+00:00",
        "seconds_here": 300.0,
        "result": result,
        **changes,
    }
    return Line(**values)


def figures(improvement: float) -> Figures:
    """At one speed."""
    return Figures(
        improvement=improvement, segments=150, valid=1.0, falls=0, mean_speed=0.79, reference_speed=0.8, metrics={}
    )
