"""From recordings to numbers: segments, intervals, head-to-heads, and candidates judged in simulation."""
