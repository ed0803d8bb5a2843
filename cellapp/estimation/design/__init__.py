"""Criteria of experimental design: information about parameters and effects, discrimination of alternative models. No
I/O."""
