"""Find the physical effect that a calibrated model lacks, name it, add it, and show how the residuals shrink."""
