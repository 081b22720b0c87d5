"""`python -m hts_go1_runtime`."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    try:
        from hts_go1_runtime.cli import main
    except ImportError as error:
        print(f"refused: {error}. It is needed beside this package: pip install numpy onnxruntime", file=sys.stderr)
        sys.exit(2)
    sys.exit(main())
