"""Which candidates are tried in reality, and which of them goes on."""
