"""hts: make robots good at what simulators cannot compute.

Measure a quantity on the real robot, learn a model of the measurement, use it as a reward in
simulation, fine-tune under a KL bound, try the best candidates on the robot, repeat.
"""

__version__ = "0.1.0"

from hts.hookspecs import hookimpl as hookimpl
