"""The table in the terminal keeps every word whole, however narrow the terminal is."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from hts.report.table import print_table

METRICS = {
    "net_reduction": 0.2,
    "gross_reduction": 0.1,
    "cost_of_transport_reduction": 0.18,
    "peak_temperature": 61.0,
    "mean_temperature": 55.5,
}


def shown(width: int, metrics: dict[str, float] = METRICS, unit: str = "1") -> str:
    row = {
        "improvement": 0.231,
        "improvement_ci95": [0.2101, 0.2517] if unit == "1" else [-1.29, 1.58],
        "mean_speed": 0.81,
        "falls": 0,
        "segments": 1234,
        "metrics": metrics,
    }
    result = {"unit": unit, "speeds": {"0.8": row, "1.1": row}}
    summary = {"final": {"policy": "01-02", "objectives": {"power": result}}}
    console = Console(record=True, width=width, file=io.StringIO())
    print_table(summary, console)
    return console.export_text()


@pytest.mark.parametrize("width", [60, 72, 80, 100, 200])
def test_no_heading_and_no_number_is_cut(width):
    text = shown(width)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    words = set(text.split())
    assert {"reduction", "transport", "temperature", "improvement", "segments", "23.1", "61.00"} <= words


def test_a_wide_terminal_gets_one_table_and_a_narrow_one_several():
    assert shown(200).count("speed") == 1
    assert shown(80).count("speed") == 2


def test_two_metrics_fit_into_eighty_columns():
    assert shown(80, {"gross_reduction": 0.1, "cost_of_transport_reduction": 0.18}).count("speed") == 1


def test_columns_that_may_not_break_leave_the_others_less():
    loud = {"mean_level": 86.66, "loud_improvement": 0.01, "per_metre_improvement": -0.03}
    text = shown(80, loud, unit="dB(A)")
    assert "…" not in text and text.count("improvement") >= 3 and max(map(len, text.splitlines())) <= 80
