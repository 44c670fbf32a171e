"""Proven lower bounds on J without a plan."""
