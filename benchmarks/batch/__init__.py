"""Many runs side by side, one JSON line each, and what is made of the lines: parts of `benchmarks/realities.py`."""
