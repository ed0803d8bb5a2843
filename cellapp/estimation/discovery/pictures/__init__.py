"""Pictures of fitted terms: partial residuals and model against the variable of the term."""
