"""Fine-tuning of candidates under a KL bound, and pretraining of the policy to start from."""
