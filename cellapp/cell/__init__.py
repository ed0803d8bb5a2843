"""The cell and its files: profile, run file, gate, plans, targets, motions, exports, programs."""
