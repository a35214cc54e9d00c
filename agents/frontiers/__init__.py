"""Learned frontier selection: linear scores optimized by CMA-ES, and an attention network."""
