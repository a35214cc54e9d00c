"""Learned explorers: PPO on stable-baselines3."""
