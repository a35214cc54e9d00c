"""Frontier exploration: rules that choose between candidates, and the explorer that drives as any of them says."""
