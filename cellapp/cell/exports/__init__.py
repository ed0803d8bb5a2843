"""Exports of the calibrated cell for other programs; each format is lossless or states what it cannot represent."""
