"""`hts bench`: how fast collection, training, sweeps and fits are, against bare physics in the same process.

Bare is the engine alone replaying the very states, actions and models that were collected: a robot in the air is
simulated twice as fast as one on its feet, so physics timed on other states would say nothing. Collection and
replay alternate, and ratios are medians over rounds, because other work on the machine slows both.
"""

from __future__ import annotations

from hts.bench.collecting import bench_env
from hts.bench.fitting import bench_fit
from hts.bench.setup import Sizes
from hts.bench.sweeping import bench_sweep
from hts.bench.training import bench_train

__all__ = ["Sizes", "bench_env", "bench_fit", "bench_sweep", "bench_train"]
