"""Battery power as an objective of hard-to-sim."""
