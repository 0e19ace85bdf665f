"""Studies: simulated tests, Monte Carlo, and the paper's own figures again."""
