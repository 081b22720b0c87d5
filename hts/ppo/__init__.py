"""Learning: anchored PPO for a population of candidates, and pretraining."""
