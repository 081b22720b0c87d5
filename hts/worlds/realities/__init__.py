"""A population of plausible realities: twins whose every parameter, and structure, is drawn.

ranges.py  what is drawn, and over what: read from the parameter classes of the twin and of installed instruments
draw.py    one draw from (seed, index)
quick.py   a glance at it by statics, before anything is simulated
check.py   whether a draw agrees with public facts
like.py    what a lab's own recordings say of its robot, to be agreed with instead of the public facts
misfit.py  how far a draw is from that; space.py: draws as points; sampler.py: points that are moved until all agree
population.py  the sampler at work on twins, side by side, resumable; posterior_like.py: what came of it
batch.py   many draws, side by side, resumable, until enough agree
truth.py   what a policy truly saves there: no noise, true speed, many sessions
"""
