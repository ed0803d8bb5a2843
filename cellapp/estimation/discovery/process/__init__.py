"""What is left after geometry and named laws, as one structured Gaussian process: components, evidence, fit."""
