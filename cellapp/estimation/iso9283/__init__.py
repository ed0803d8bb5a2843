"""ISO 9283: formulas of the characteristics, test cube and poses, sequence of visits. No I/O."""
