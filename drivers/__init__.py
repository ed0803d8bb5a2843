"""Drivers for arms, trackers and sensors, and the simulated cell behind them. Imports nothing from cellapp."""
