"""PPO training of one candidate, exactly resumable, and of a population of them. Never sees the model."""
