"""Programs of Universal Robots' controllers: their targets read, corrected by the calibrated model, written back."""
