"""`python -m hts_go1_runtime`."""

from __future__ import annotations

import sys

from hts_go1_runtime.cli import main

if __name__ == "__main__":
    sys.exit(main())
