"""Criteria of experimental design: what stops tell about parameters, effects and rivals."""
