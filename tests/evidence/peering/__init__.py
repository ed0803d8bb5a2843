"""Problems that other libraries solve too, and a driver of each."""
