"""The twin: simulated reality. It differs from the training simulator in structure, not only in numbers.

parameters.py  every number of the twin, with unit, source and range
model.py       the robot's MJCF, made into another machine
dynamics.py    W robots at 1 kHz: delay, motor limits, gear friction, physics, instruments
sensors.py     what the robot's own sensors show of it
session.py     policies, operator, falls, head-to-heads; makes recordings
process.py     `python -m hts.worlds.twin.process`: the twin's own process
world.py       the side that a run talks to
"""
