"""The log reader `jsonl`, for hts."""
