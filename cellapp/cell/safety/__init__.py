"""The gate that every motion passes: limits, bodies, arm against arm, way by way."""
