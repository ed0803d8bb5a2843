"""Measured errors against tolerances: decision rules, judgements of a run, uncertainty budgets. No I/O."""
