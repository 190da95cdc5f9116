"""The paper's tables and figures, and what the paper does not look at: solvers beside their limits."""
