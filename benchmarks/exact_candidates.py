"""One run until an iteration's candidates are trained, and what the reality's instruments say of them: for
`benchmarks/realities.py exact run`, which calls it.

    python benchmarks/exact_candidates.py ITERATION run --objective power --robot go1 … --out FOLDER
    python benchmarks/exact_candidates.py ITERATION resume FOLDER
"""

from __future__ import annotations

import sys

from batch.exact import make

from hts.errors import HtsError


def main() -> int:
    """The status of the run, or a mistake's."""
    try:
        return make(int(sys.argv[1]), sys.argv[2:])
    except HtsError as error:
        print(f"error: {error}", flush=True)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
