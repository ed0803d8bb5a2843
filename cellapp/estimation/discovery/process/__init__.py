"""Residuals of geometry and named laws as one structured Gaussian process: components, evidence, fit."""
