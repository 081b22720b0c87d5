"""`python -m hts`, as `hts`."""

from __future__ import annotations

import sys

from hts.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
