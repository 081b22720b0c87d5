"""`hts`: where the command line begins and where every error ends as one line."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

INTERRUPTED = 130  # 128 + SIGINT, what shells expect


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status. HTS_DEBUG=1 shows tracebacks instead of one line."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:
        from hts import __version__

        print(f"hts {__version__}")
        return 0

    # dm_control looks for a display when it is imported and warns without one; nothing here needs it.
    warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")
    from hts.cli.group import hts_group
    from hts.cli.one_line import one_line
    from hts.cli.printable import printable

    try:
        status = hts_group().main(args=arguments or ["--help"], prog_name="hts", standalone_mode=False)
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        explained = one_line(error)
        if explained is None or os.environ.get("HTS_DEBUG") == "1":
            raise
        line, code = explained
        print(printable(line), file=sys.stderr)
        return code
    return status if isinstance(status, int) else 0


if __name__ == "__main__":
    sys.exit(main())
