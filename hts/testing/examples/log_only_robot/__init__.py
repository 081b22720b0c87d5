"""The robot `logged`, known by its logs, for hts."""
