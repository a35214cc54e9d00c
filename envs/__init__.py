"""Lidarnaut: Gymnasium environments for robots that explore unknown places."""
