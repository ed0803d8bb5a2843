"""The page of a run, a certificate or a fleet as one HTML file."""
