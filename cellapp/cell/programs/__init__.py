"""Programs of Universal Robots' controllers: read their targets, correct them with the calibrated model, write them."""
