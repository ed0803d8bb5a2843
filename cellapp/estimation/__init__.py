"""Estimation of the arms' models from readings. No input or output: arrays in, arrays out."""
