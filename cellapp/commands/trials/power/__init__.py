"""Which effects, from which size on, a plan would find."""
