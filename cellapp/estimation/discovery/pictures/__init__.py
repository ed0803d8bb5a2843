"""Pictures of fitted terms: partial residuals and model against what the term depends on."""
