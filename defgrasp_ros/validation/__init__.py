"""Experiments with known answers that show how right the simulation is; ``defgrasp validate`` runs them."""
