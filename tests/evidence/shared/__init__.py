"""What several programs share: measured series, simulated cells drawn by a seed."""
