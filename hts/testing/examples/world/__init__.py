"""The world `hoist`, for hts."""
