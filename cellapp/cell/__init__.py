"""What stands in the cell and in its files: profile, run file, gate, plans, targets, motions, exports, programs."""
