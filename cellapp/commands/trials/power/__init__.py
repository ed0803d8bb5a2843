"""Which effects of which size a plan would have named."""
