"""A virtual environment for a benchmark's rival, on top of the one that runs the benchmark.

What the two share (torch, numpy, …) is taken from the environment of this Python; what the rival needs in another
version, or what only it needs, is installed into its own, which comes first.
"""

from __future__ import annotations

import hashlib
import shutil
import site
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

PLACE = Path(__file__).parent / ".environments"


def python_with(name: str, requirements: Sequence[str], place: Path = PLACE) -> Path:
    """The Python of an environment with these requirements (nothing else is fetched), made if it is not there yet."""
    folder = place / name
    python = folder / "bin" / "python"
    stamp = folder / "made"
    wanted = hashlib.sha256("\n".join((sys.prefix, *requirements)).encode()).hexdigest()
    if stamp.exists() and stamp.read_text() == wanted:
        return python
    print(f"making {folder}: {', '.join(requirements)}", file=sys.stderr)
    shutil.rmtree(folder, ignore_errors=True)
    venv.create(folder, with_pip=True)
    packages = next(folder.glob("lib/python*/site-packages"))
    below = "; ".join(f"site.addsitedir({str(path)!r})" for path in site.getsitepackages())
    (packages / "below.pth").write_text(f"import site; {below}\n")
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*install, *requirements], check=True, stdout=sys.stderr)
    stamp.write_text(wanted)
    return python
