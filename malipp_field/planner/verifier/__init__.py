"""The independent verifier: no plan leaves the planner that it has not passed."""
