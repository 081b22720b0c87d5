"""Reinforcement learning that knows no task: losses, collectors, actors and critics for a population of candidates."""
