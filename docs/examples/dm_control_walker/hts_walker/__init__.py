"""A dm_control suite task as a robot for hts."""
