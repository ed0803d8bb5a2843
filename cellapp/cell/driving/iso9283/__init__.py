"""Tests by ISO 9283 as motions: cube, poses and commands of an arm, and driving them."""
