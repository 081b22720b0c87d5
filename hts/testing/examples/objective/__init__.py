"""The objective `fake`, for hts."""
