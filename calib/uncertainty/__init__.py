"""What a measured depth, position or length is worth: budgets, Monte Carlo, conformity."""
