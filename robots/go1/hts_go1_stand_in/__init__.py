"""A process that plays a Go1 for the runtime: a twin or a reality at the far end of a UDP line.

    python -m hts_go1_stand_in --port 9870 --reality dev-03 --lockstep

For practice and tests. What is recorded with it was recorded on a simulated robot.
"""
