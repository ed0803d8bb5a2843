"""Models of arms: kinematics, physical effects, paths. No input or output."""
