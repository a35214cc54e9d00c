"""Learned frontier selection: evolved scores and an attention network."""
