"""Emulated devices under the real client: faults of links, a person at a terminal, a storm, the tracker bridge."""
