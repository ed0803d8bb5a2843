"""Tables of a run for pandas, by a short path; see ``cellapp.interfaces.python.dataframes``."""

from cellapp.interfaces.python.dataframes import parameters, readings, residuals, targets

__all__ = ["parameters", "readings", "residuals", "targets"]
