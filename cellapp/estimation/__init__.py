"""What is known about the arms. No input or output: arrays in, arrays out."""
