"""The calibrated cell for other programs, each format lossless or saying what it cannot carry."""
