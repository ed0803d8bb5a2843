"""ISO 9283: formulas of the characteristics, test cube and poses, programme of visits. No I/O."""
