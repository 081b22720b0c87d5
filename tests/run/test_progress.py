"""What a run says of its progress where nobody watches a bar."""

import io
import time

from rich.console import Console

from hts.run.progress import Progress


def lines(monkeypatch, reports: list[tuple[float, float]]) -> list[str]:
    """What a stage prints that reports (time, s; share done) in turn."""
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    out = io.StringIO()
    with Progress(1, Console(file=out, width=120)).stage("train") as report:
        for clock[0], share in reports:
            report(share)
    return [line.strip() for line in out.getvalue().splitlines()[1:-1]]


def test_the_time_left_follows_from_the_share_done(monkeypatch):
    assert lines(monkeypatch, [(10.0, 0.1), (20.0, 0.25)]) == ["25%, about 60 s left"]


def test_what_compiles_first_is_not_taken_for_the_speed_of_the_rest(monkeypatch):
    said = lines(monkeypatch, [(40.0, 0.01), (50.0, 0.26), (60.0, 0.51)])
    assert said == ["1%", "51%, about 20 s left"]
