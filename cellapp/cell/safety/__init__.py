"""The gate that every motion passes: joint limits, bodies, arm against arm, along the whole path."""
