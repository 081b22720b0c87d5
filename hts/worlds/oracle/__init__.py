"""The oracle: a reality as a training env, with its own dynamics and what its instruments hide as the reward.

It asks what would have been possible on a twin for somebody who saw inside it: a lower estimate, and no method. Nothing
else may look in here: learning code sees an env like any other and cannot import this package (import-linter).
"""

NOTE = "oracle: saw inside the reality; no method"
"""Stands wherever a result of an oracle does."""
IN_SIMULATION = "oracle of the reward: trained in simulation, paid by the reality's own instruments; no method"
"""The same where only the reward saw inside."""
