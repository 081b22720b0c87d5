"""Stepping noise as an objective of hard-to-sim."""
