"""Physics for training: one small interface, two engines."""
