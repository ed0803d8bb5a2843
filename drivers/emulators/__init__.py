"""Servers that speak a real device's wire, so that drivers can be tried without it."""
