"""Policies: a population of actor-critics, their files, and their form on a robot."""
