"""Criteria of experimental design: information about parameters and effects, discrimination of rival models. No I/O."""
