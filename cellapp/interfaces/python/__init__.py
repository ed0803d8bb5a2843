"""Python access to cells and runs, as plain objects and data frames."""
