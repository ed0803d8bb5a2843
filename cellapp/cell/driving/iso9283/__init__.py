"""Tests of ISO 9283 as motions: cube, poses and commands of an arm, and how they are driven."""
