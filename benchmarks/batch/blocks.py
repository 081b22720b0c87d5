"""Numbers in pages come from lines: blocks between markers are written here, and what stands outside is watched.

    <!-- results: methods lines=test-quick.jsonl preset=quick -->
    | method | ... written by `python benchmarks/realities.py write-docs`
    <!-- end -->

In the midst of a sentence, `value` writes one number: results: value lines=… method=ours statistic=median speed=0.8.
metric=gross_reduction takes one of the objective's metrics, in the unit of its improvement; realities=default,dev-02
leaves out the lines of others. kind=open_loop compares `pairs` at equal commands.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

from batch import tables
from batch.ablation import ablation
from batch.all_tables import ALL
from batch.coverage_lines import coverage_table, read_coverage
from batch.exact_gap import gap_table
from batch.exact_lines import read_exact
from batch.expected_lines import expected_table, read_expected
from batch.groups import Group, groups_of
from batch.lines import Line, files_of, read_lines
from batch.together import together
from hts.errors import EvaluationError, unknown_name
from hts.evaluation.population import mean, population, quantile

MARKER = re.compile(r"(?<!`)<!-- results: (?P<what>[^>]*?) -->(?P<body>.*?)<!-- end -->", re.DOTALL)
BEGIN = re.compile(r"(?<!`)<!-- results:")
SAVED = r"\d+(?:\.\d+)?(?= ?(?:%|dB|percentage point|points?\b|per cent))"
WITH_DECIMALS = re.compile(SAVED + r"|\d+\.\d+")
NUMBER = {
    "README.md": re.compile(SAVED),
    "docs/results.md": WITH_DECIMALS,
    "docs/results-version-before.md": WITH_DECIMALS,
    "docs/results-development.md": WITH_DECIMALS,
    "docs/results-earlier.md": WITH_DECIMALS,
}
"""What counts as a number of a result in the pages that are watched: in all but the first, any with decimals."""
KEYS = {
    *("lines", "preset", "methods", "as-one", "realities", "objective", "against"),
    *("method", "statistic", "speed", "metric", "kind"),
}
STATISTICS = {"median": quantile(0.5), "mean": mean, "5th-percentile": quantile(0.05), "lowest": quantile(0.0)}
COUNTS = ("falls", "refused", "runs", "realities", "real-samples")


def pages(repository: Path) -> list[Path]:
    """Those that may hold blocks."""
    return [repository / "README.md", *sorted((repository / "docs").glob("*.md"))]


def written(text: str, lines: Path) -> str:
    """The page with all its blocks made anew from the files in the folder `lines`.

    Raises EvaluationError for a block that cannot be made, naming it.
    """

    @cache
    def read(files: str) -> list[Line]:
        """Most blocks of a page are of the same few files."""
        return read_lines(files_of([lines / file for file in files.split(",")]))

    def block(match: re.Match[str]) -> str:
        what, body = match["what"].strip(), match["body"]
        made = _made(what, lines, read)
        around = "\n" if "\n" in body or "\n" in made else ""
        return f"<!-- results: {what} -->{around}{made}{around}<!-- end -->"

    if len(BEGIN.findall(text)) != len(MARKER.findall(text)):
        raise EvaluationError("A block of results begins and does not end. Put <!-- end --> behind it.")
    return MARKER.sub(block, text)


def outside(page: str, text: str) -> Counter[str]:
    """Numbers of results in a watched page that stand in no block, and how often."""
    return Counter(NUMBER[page].findall(MARKER.sub("", text)))


def strangers(page: str, text: str, allowed: Mapping[str, int]) -> list[str]:
    """Those beyond what is allowed."""
    return sorted((outside(page, text) - Counter(allowed)).elements())


def remaining(page: str, text: str, allowed: Mapping[str, int]) -> dict[str, int]:
    """What is allowed and still stands there: the list only gets shorter."""
    return dict(outside(page, text) & Counter(allowed))


def read_older(path: Path) -> dict[str, dict[str, int]]:
    """page -> number -> how often: figures of before lines were kept, and numbers that are no results."""
    return json.loads(path.read_text(encoding="utf-8"))


def older_text(older: Mapping[str, Mapping[str, int]]) -> str:
    """As the file that `read_older` reads."""
    return json.dumps({page: dict(sorted(found.items())) for page, found in older.items()}, indent=1) + "\n"


def _made(what: str, folder: Path, read: Callable[[str], list[Line]]) -> str:
    name, *rest = what.split()
    given = dict(part.partition("=")[::2] for part in rest)
    where = f"Block 'results: {what}'"
    wrong = sorted(set(given) - KEYS)
    if wrong or "lines" not in given:
        raise EvaluationError(f"{where}: expected lines=FILE and any of {', '.join(sorted(KEYS))}; found {rest}.")
    try:
        if name == "coverage":
            return coverage_table(
                read_coverage(files_of([folder.parent / "coverage" / f for f in given["lines"].split(",")]))
            )
        if name == "expected":
            found = [read_expected(folder.parent / "expected" / file) for file in given["lines"].split(",")]
            return expected_table([row for rows in found for row in rows])
        groups = groups_of(
            _of_realities(read(given["lines"]), given),
            given.get("preset"),
            given["methods"].split(",") if "methods" in given else None,
            given.get("objective"),
            given["as-one"].split(",") if "as-one" in given else (),
        )
        if name == "gap":
            return gap_table(
                groups, read_exact(files_of([folder.parent / "exact" / f for f in given["lines"].split(",")]))
            )
        if name == "value":
            return _value(groups, given)
        if name == "pairs":
            return tables.pairs(groups, given.get("against", "ours"), given.get("kind", "chosen"))
        if name == "together":
            return together(groups, given.get("against", "ours"))
        if name == "ablation":
            return ablation(groups, given.get("against", "ours"))
        if name not in ALL:
            raise EvaluationError(
                unknown_name(
                    "table", name, [*ALL, "pairs", "together", "ablation", "coverage", "expected", "gap", "value"]
                )
            )
        return ALL[name](groups)
    except EvaluationError as error:
        raise EvaluationError(f"{where}: {error}") from error


def _of_realities(lines: list[Line], given: Mapping[str, str]) -> list[Line]:
    """Those that are asked for. Raises EvaluationError for one that no line has."""
    if "realities" not in given:
        return lines
    asked, known = given["realities"].split(","), {line.reality for line in lines}
    for name in asked:
        if name not in known:
            raise EvaluationError(unknown_name("reality in these lines", name, sorted(known)))
    return [line for line in lines if line.reality in asked]


def _value(groups: Sequence[Group], given: Mapping[str, str]) -> str:
    """One number of one method, for a sentence."""
    method, statistic = given.get("method", "ours"), given.get("statistic", "median")
    named = {group.name: group for group in groups}
    if method not in named:
        raise EvaluationError(unknown_name("method in these lines", method, named))
    group, speed = named[method], given.get("speed")
    if statistic in COUNTS:
        values = group.values()
        return {
            "falls": f"{group.final_falls()}",
            "refused": f"{group.count_refused()}",
            "runs": f"{len(group.results)}",
            "realities": f"{len(values)}",
            "real-samples": tables.samples_median(group),
        }[statistic]
    if statistic not in STATISTICS:
        raise EvaluationError(unknown_name("statistic", statistic, [*STATISTICS, *COUNTS]))
    values = group.values(speed, metric=given.get("metric"))
    return tables.shown(group.unit)(population(values, STATISTICS[statistic]).estimate)
