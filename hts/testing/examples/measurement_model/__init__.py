"""The measurement model `fading`, for hts."""
