"""Where policies run "for real": the twin (simulated reality) and the field (a person with a robot).

Learning code may not import this package; it sees worlds only through `hts.contracts.World`.
"""
