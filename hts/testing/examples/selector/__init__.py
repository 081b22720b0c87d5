"""The selector `plain`, for hts."""
