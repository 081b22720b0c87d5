"""The instrument `warmth`, for hts."""
