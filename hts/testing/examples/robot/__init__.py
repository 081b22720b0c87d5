"""The robot `tiny`, for hts."""
